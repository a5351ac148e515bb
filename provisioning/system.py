"""The system that RCE is installed on: where things are, and what is there already. Standard library only."""

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

from provisioning.steps import Failed

USER = "rce"
ETC, OPT, VAR = "/etc/rce", "/opt/rce", "/var/lib/rce"
UNITS = "/etc/systemd/system"
CURRENT = f"{OPT}/current"  # the release that runs
TLS, AUTHORITY_KEY = f"{ETC}/tls", f"{ETC}/authority/ca.key"
DOCKER = ("docker", "swarm")  # the engines that need it
MAPS = "map-service"  # which is where the Master is
ROLES = ("master", "robot", "container")  # that can be asked for
SERVICES = (*ROLES, MAPS)
KNOWN = {("debian", "12"), ("debian", "13"), ("ubuntu", "24.04")}


@dataclass(frozen=True)
class System:
    """The system whose files are under `root`. Only that at / can be changed; another one can be planned for."""

    root: Path = Path("/")

    def path(self, name: str) -> Path:
        return self.root / name.lstrip("/")

    def release(self) -> tuple[str, str]:
        """As in os-release, such as debian 12."""
        try:
            lines = self.path("/etc/os-release").read_text().splitlines()
        except OSError:
            return "", ""
        values = {key: value.strip('"') for key, _, value in (line.partition("=") for line in lines)}
        return values.get("ID", ""), values.get("VERSION_ID", "")

    def runs_systemd(self) -> bool:
        return self.path("/run/systemd/system").is_dir()

    def has_user(self) -> bool:
        return f"\n{USER}:" in "\n" + self.text("/etc/passwd")

    def has_program(self, name: str) -> bool:
        if self.root == Path("/"):
            return program(name) is not None
        return any(self.path(f"/usr/{place}/{name}").exists() for place in ("bin", "sbin", "local/bin"))

    def python(self) -> str:
        """The Python to install with. Failed if there is none."""
        if self.root == Path("/"):
            return public_python()
        names = [f"/usr/bin/python3.{minor}" for minor in (13, 12, 11)]
        return next((name for name in names if self.path(name).exists()), "/usr/bin/python3")

    def text(self, name: str) -> str:
        """The content of a file, empty if there is none."""
        try:
            return self.path(name).read_text()
        except OSError:
            return ""

    def roles(self) -> tuple[str, ...]:
        """The services that are installed here."""
        return tuple(role for role in SERVICES if self.path(f"{ETC}/{role}.toml").exists())

    def file_is(self, name: str, text: str) -> bool:
        return self.path(name).is_file() and self.text(name) == text

    def write(self, name: str, text: str, mode: int, group: str = "root") -> None:
        """All of it or nothing, never readable by more than `mode` says; owned by root."""
        path = self.path(name)
        draft = path.with_name(f".{path.name}.new")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(text)
        own(draft, "root", group, mode)
        draft.rename(path)


def own(path: Path, user: str, group: str, mode: int) -> None:
    os.chown(path, pwd.getpwnam(user).pw_uid, grp.getgrnam(group).gr_gid)
    path.chmod(mode)


def unit(role: str) -> str:
    return f"rce-{role}.service"


def program(name: str) -> str | None:
    """Also one that is for root only, and not on other users' PATH."""
    return shutil.which(name, path=f"{os.environ.get('PATH', os.defpath)}:/usr/sbin:/sbin")


def docker_answers() -> bool:
    docker = program("docker")
    return docker is not None and _succeeds(docker, "version")


def _succeeds(*command: str) -> bool:
    return subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode == 0


def public_python() -> str:
    """A Python that every user of this system may run: the services do not run as root. Failed if there is none."""
    own_python = os.path.realpath(sys.executable)
    names = [own_python, *(f"/usr/bin/python3.{minor}" for minor in (13, 12, 11))]
    for name in names:
        path = Path(name)
        if path.exists() and all(directory.stat().st_mode & stat.S_IXOTH for directory in (path, *path.parents)):
            return name
    raise Failed(f"{own_python} is for its owner only: apt-get install python3, or use a Python that all may run")


def own_address(towards: str = "192.0.2.1") -> str:
    """The address of this machine on its way to another one; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((towards, 9))
        except OSError:
            return "127.0.0.1"
        return str(probe.getsockname()[0])
