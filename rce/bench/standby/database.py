"""A private PostgreSQL on a machine of its own."""

from __future__ import annotations

import glob
import os
import pwd
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from rce.errors import Unavailable

PLACES = "/usr/lib/postgresql/*/bin"
OWNER = "postgres"
PORT = 5432


def program(name: str) -> str:
    """Return the path of a program of PostgreSQL, which Debian does not put on the path.

    Raises:
        Unavailable: PostgreSQL is not installed.
    """
    found = sorted(glob.glob(f"{PLACES}/{name}")) or [each for each in [shutil.which(name)] if each]
    if not found:
        raise Unavailable("PostgreSQL is not installed: apt-get install postgresql")
    return found[-1]


class Database:
    """PostgreSQL with its files and its socket in `directory`, at a TCP address besides."""

    def __init__(self, directory: Path, address: str, prefix: Sequence[str], environment: Mapping[str, str]) -> None:
        """Describe a database, which `start` makes and starts.

        Args:
            directory: An empty directory, which `postgres` can reach.
            address: Address to listen at.
            prefix: Words before a command that run it on the machine with this address.
            environment: Additional environment variables.
        """
        self._directory = directory
        self._address = address
        self._prefix = prefix
        self._environment = os.environ | environment

    @property
    def url(self) -> str:
        """SQLAlchemy URL for Masters."""
        return f"postgresql+psycopg://rce@{self._address}:{PORT}/postgres"

    @property
    def local(self) -> str:
        """Connection string for this machine, which no cut of a link concerns."""
        return f"host={self._directory} port={PORT} user=rce dbname=postgres"

    def start(self) -> None:
        """Make the database and start it.

        Raises:
            Unavailable: PostgreSQL is not installed, or does not start.
        """
        self._directory.mkdir(parents=True, exist_ok=True)
        if os.geteuid() == 0:
            owner = pwd.getpwnam(OWNER)
            os.chown(self._directory, owner.pw_uid, owner.pw_gid)
        data = self._directory / "data"
        self._run("initdb", "-D", data, "-U", "rce", "-A", "trust", "-E", "UTF8", "--locale=C", "--no-sync")
        with (data / "pg_hba.conf").open("a") as rules:
            rules.write("host all all 0.0.0.0/0 trust\n")  # of a network that exists for this run only
        options = f"-F -p {PORT} -c listen_addresses={self._address} -k {self._directory}"
        self._run("pg_ctl", "-D", data, "-w", "-o", options, "-l", self._directory / "log", "start")

    def stop(self) -> None:
        """Stop it at once."""
        self._run("pg_ctl", "-D", self._directory / "data", "-m", "immediate", "stop")

    def _run(self, name: str, *words: str | Path) -> None:
        user = ["runuser", "-u", OWNER, "--"] if os.geteuid() == 0 else []
        command = [*self._prefix, *user, program(name), *map(str, words)]
        done = subprocess.run(
            command, env=self._environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=False
        )
        if done.returncode:
            raise Unavailable(f"{name} failed: {done.stdout[-300:]}")
