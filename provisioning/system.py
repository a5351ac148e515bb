"""The operating system that RCE is installed on: paths, and queries of its state. Standard library only."""

from __future__ import annotations

import grp
import os
import pwd
import shutil
import socket
import stat
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from provisioning.steps import ProvisioningError

USER = "rce"
ETC, OPT, VAR = "/etc/rce", "/opt/rce", "/var/lib/rce"
UNITS = "/etc/systemd/system"
CURRENT = f"{OPT}/current"  # link to the current release
TLS, AUTHORITY_KEY = f"{ETC}/tls", f"{ETC}/authority/ca.key"
DOCKER = ("docker", "swarm")  # engines that need it
MAPS, KNOWLEDGE = "map-service", "knowledge-service"
WEB_SERVICES = (MAPS, KNOWLEDGE)  # on the Master's machine
ROLES = ("master", "robot", "container")  # values of --role
SERVICES = (*ROLES, *WEB_SERVICES)
KNOWN = {("debian", "12"), ("debian", "13"), ("ubuntu", "24.04")}


@dataclass(frozen=True)
class System:
    """The system whose files are under `root`.

    Only the system at / can be changed; for others `install --dry-run` prints a plan.
    """

    root: Path = Path("/")

    def path(self, name: str) -> Path:
        """Return the path of an absolute file name of this system."""
        return self.root / name.lstrip("/")

    def release(self) -> tuple[str, str]:
        """Return name and version of the distribution, such as `("debian", "12")`; empty if unknown."""
        try:
            lines = self.path("/etc/os-release").read_text().splitlines()
        except OSError:
            return "", ""
        values = {key: value.strip('"') for key, _, value in (line.partition("=") for line in lines)}
        return values.get("ID", ""), values.get("VERSION_ID", "")

    def runs_systemd(self) -> bool:
        """Return True if systemd runs here."""
        return self.path("/run/systemd/system").is_dir()

    def has_user(self) -> bool:
        """Return True if the user of the services exists."""
        return f"\n{USER}:" in "\n" + self.text("/etc/passwd")

    def has_program(self, name: str) -> bool:
        """Return True if a program is installed."""
        if self.root == Path("/"):
            return program(name) is not None
        return any(self.path(f"/usr/{place}/{name}").exists() for place in ("bin", "sbin", "local/bin"))

    def python(self) -> str:
        """Return the Python to install with.

        Raises:
            ProvisioningError: There is none that all users can run.
        """
        if self.root == Path("/"):
            return public_python()
        names = [f"/usr/bin/python3.{minor}" for minor in (13, 12, 11)]
        return next((name for name in names if self.path(name).exists()), "/usr/bin/python3")

    def text(self, name: str) -> str:
        """Return the content of a file, or "" if it cannot be read."""
        try:
            return self.path(name).read_text()
        except OSError:
            return ""

    def roles(self) -> tuple[str, ...]:
        """Return the roles that are installed here."""
        return tuple(role for role in SERVICES if self.path(f"{ETC}/{role}.toml").exists())

    def file_is(self, name: str, text: str) -> bool:
        """Return True if a file exists and has this content."""
        return self.path(name).is_file() and self.text(name) == text

    def write(self, name: str, text: str, mode: int, group: str = "root") -> None:
        """Write a file of root's atomically. Its content is never readable to more users than `mode` allows."""
        path = self.path(name)
        draft = path.with_name(f".{path.name}.new")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(text)
        own(draft, "root", group, mode)
        draft.rename(path)


def own(path: Path, user: str, group: str, mode: int) -> None:
    """Set owner, group and mode of a file."""
    os.chown(path, pwd.getpwnam(user).pw_uid, grp.getgrnam(group).gr_gid)
    path.chmod(mode)


def unit(role: str) -> str:
    """Return the name of the systemd unit of a role."""
    return f"rce-{role}.service"


def program(name: str) -> str | None:
    """Find a program, in root's directories too, which are not on other users' PATH."""
    return shutil.which(name, path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/sbin")


def docker_answers() -> bool:
    """Return True if Docker is installed and its daemon answers."""
    docker = program("docker")
    return docker is not None and _succeeds(docker, "version")


def _succeeds(*command: str) -> bool:
    return subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode == 0


def public_python() -> str:
    """Return a Python that all users of this system can run, because the services do not run as root.

    Raises:
        ProvisioningError: There is none.
    """
    own_python = os.path.realpath(sys.executable)
    names = [own_python, *(f"/usr/bin/python3.{minor}" for minor in (13, 12, 11))]
    for name in names:
        path = Path(name)
        if path.exists() and all(directory.stat().st_mode & stat.S_IXOTH for directory in (path, *path.parents)):
            return name
    raise ProvisioningError(
        f"other users cannot run {own_python}: apt-get install python3, or use a Python that all can run"
    )


def own_address(towards: str = "192.0.2.1") -> str:
    """Return the address of this machine on its route to another one. Nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((towards, 9))
        except OSError:
            return "127.0.0.1"
        return str(probe.getsockname()[0])
