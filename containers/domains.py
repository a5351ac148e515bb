"""ROS domain ids, each for one environment of the whole host.

A domain is taken by an exclusive lock on a file in a directory that all platforms on this host share. The lock belongs
to the open file, so the environment's process inherits it and holds its domain even when the task set is killed.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from rce.errors import NoCapacity

DIRECTORY = Path("/tmp/rce-domains")
# Linux's ephemeral ports begin at 32768: of domains above 101 they may take the ports. 0 is everybody's default.
DOMAINS = range(1, 102)


class Domains:
    """The domains of a host."""

    def __init__(self, directory: Path = DIRECTORY, domains: range = DOMAINS) -> None:
        self._directory = directory
        self._domains = domains

    def take(self) -> tuple[int, int]:
        """A domain that nobody uses, and the file descriptor that holds it; NoCapacity when there is none."""
        heard = _in_use()
        for domain in self._domains:
            if domain not in heard and (lock := self.hold(domain)) is not None:
                return domain, lock
        raise NoCapacity(
            f"all {len(self._domains)} ROS domains of this host are in use; "
            "remove an environment or use an engine with networks of its own",
            domains=len(self._domains),
        )

    def hold(self, domain: int) -> int | None:
        """A file descriptor that holds this domain until it is closed, or None when another does."""
        self._make_directory()
        lock = self._open(self._directory / str(domain))
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            return None
        return lock

    def _make_directory(self) -> None:
        try:
            self._directory.mkdir()
        except FileExistsError:
            return
        self._directory.chmod(0o1777)

    @staticmethod
    def _open(path: Path) -> int:
        """To lock a file it is enough to read it, so other users' files do as well as our own."""
        flags = os.O_RDONLY | os.O_NOFOLLOW
        try:
            return os.open(path, flags)
        except FileNotFoundError:
            return os.open(path, flags | os.O_CREAT, 0o644)


def _in_use() -> set[int]:
    """Domains in which somebody on this host takes part now, ours or not: by their UDP ports (RTPS 2.5, 9.6.2.3)."""
    ports: set[int] = set()
    for table in (Path("/proc/net/udp"), Path("/proc/net/udp6")):
        if table.exists():
            rows = table.read_text().splitlines()[1:]
            ports |= {int(row.split()[1].rpartition(":")[2], 16) for row in rows}
    return {(port - 7400) // 250 for port in ports if port >= 7400}
