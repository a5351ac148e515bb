"""The later steps of `install`: settings, units, the administrator, Docker and its images, the start.

Standard library only.
"""

from __future__ import annotations

import os
import secrets
import sqlite3
from collections.abc import Collection, Sequence
from contextlib import closing
from pathlib import Path

from provisioning import configuration, units
from provisioning.configuration import Wanted
from provisioning.steps import ROOT, Step, run
from provisioning.system import CURRENT, ETC, UNITS, USER, VAR, System, docker_answers, unit

PASSWORD = f"{ETC}/admin-password"
SYSCTL, RMEM_MAX = "/etc/sysctl.d/60-rce.conf", "/proc/sys/net/core/rmem_max"
RECEIVE_BUFFER = 4 * 1024 * 1024  # as the endpoint asks for
STOP_ORDER = ("map-service", "container", "robot", "master")
START_ORDER = tuple(reversed(STOP_ORDER))  # each finds the Master there; none needs it


def file_steps(system: System, wanted: Wanted) -> list[Step]:
    """Settings and units as they shall be, and the first user."""
    return [
        Step("settings", lambda: " ".join(_stale_settings(system, wanted)), lambda: _write_settings(system, wanted)),
        Step("units", lambda: " ".join(_stale_units(system, wanted)), lambda: _write_units(system, wanted)),
        *([_administrator_step(system)] if "master" in wanted.roles else []),
    ]


def _settings(system: System, wanted: Wanted) -> dict[str, str]:
    """File by file; as they are if nothing changes in them but their layout."""
    values = configuration.settings(wanted, system)
    return {
        f"{ETC}/{role}.toml": configuration.text(role, values[role])
        for role in wanted.roles
        if values[role] != configuration.read(system, role)
    }


def _stale_settings(system: System, wanted: Wanted) -> list[str]:
    return list(_settings(system, wanted))


def _write_settings(system: System, wanted: Wanted) -> str:
    texts = _settings(system, wanted)
    for name, text in texts.items():
        system.write(name, text, 0o640, USER)
    return " ".join(texts)


def _units(system: System, wanted: Wanted) -> dict[str, str]:
    texts = {f"{UNITS}/{unit(role)}": units.text(role, wanted.engine) for role in wanted.roles}
    return {name: text for name, text in texts.items() if not system.file_is(name, text)}


def _stale_units(system: System, wanted: Wanted) -> list[str]:
    return list(_units(system, wanted))


def _write_units(system: System, wanted: Wanted) -> str:
    texts = _units(system, wanted)
    for name, text in texts.items():
        system.path(name).parent.mkdir(parents=True, exist_ok=True)
        system.write(name, text, 0o644)
    return " ".join(texts)


# --- the administrator ------------------------------------------------------------------------------------------------


def as_user(*command: str) -> list[str]:
    return ["runuser", "-u", USER, "--", *command]


def _administrator_step(system: System) -> Step:
    """Made before the Master's first start, which else would print a password into the journal."""
    database = system.path(f"{VAR}/master/master.db")

    def add() -> str:
        password = secrets.token_urlsafe(15)
        command = as_user(f"{CURRENT}/bin/rce", "user", f"--data-dir={VAR}/master", "add", "admin", "--role", "admin")
        run(*command, secret=password + "\n")
        system.write(PASSWORD, password + "\n", 0o600)
        return f"user admin, password in {PASSWORD}"

    return Step("administrator", lambda: "" if has_users(str(database)) else f"user admin, password in {PASSWORD}", add)


def has_users(database: str) -> bool:
    if not os.path.exists(database):
        return False
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
        try:
            return bool(connection.execute("SELECT count(*) FROM users").fetchone()[0])
        except sqlite3.OperationalError:
            return False


# --- Docker -----------------------------------------------------------------------------------------------------------


def kernel_step(system: System) -> Step:
    """What nodes of network groups may take for the bursts of large messages."""

    def write() -> str:
        system.path(SYSCTL).parent.mkdir(exist_ok=True)
        system.write(SYSCTL, f"# Large messages in network groups.\nnet.core.rmem_max = {RECEIVE_BUFFER}\n", 0o644)
        if receive_buffer() >= RECEIVE_BUFFER:
            return SYSCTL
        try:
            Path(RMEM_MAX).write_text(str(RECEIVE_BUFFER))
        except OSError:
            return f"{SYSCTL}, from the next start of this machine on"
        return SYSCTL

    todo = "" if system.path(SYSCTL).exists() else f"{SYSCTL}: net.core.rmem_max = {RECEIVE_BUFFER}"
    return Step("kernel", lambda: todo, write)


def receive_buffer() -> int:
    """The most bytes that a socket may have for what it receives; 0 where it is not known."""
    try:
        return int(Path(RMEM_MAX).read_text())
    except OSError:
        return 0


def docker_steps(system: System) -> list[Step]:
    """Docker starts with the system."""

    def start() -> str:
        if not system.runs_systemd():
            return "left alone: systemd does not run here; start dockerd by hand"
        run("systemctl", "enable", "--now", "docker.service")
        return "docker.service"

    return [
        kernel_step(system),
        Step("docker", lambda: "" if docker_answers() else "start it, now and with the system", start),
    ]


def image_step() -> Step:
    """The images of environments, by the code of this checkout."""

    def build() -> str:
        if not docker_answers():
            return "left out: no Docker answers; later: provisioning/provision image"
        python = f"{CURRENT}/bin/python"
        output = run(python, "-P", "-m", "provisioning.image", environment={"PYTHONPATH": str(ROOT)})
        return output.strip().splitlines()[-1]

    return Step("images", lambda: "build what is not in Docker's cache yet", build)


# --- start and stop ---------------------------------------------------------------------------------------------------


def start_step(system: System, roles: Collection[str]) -> Step:
    """Services that run are restarted, so that they are of the current release with the current settings."""
    names = [unit(role) for role in START_ORDER if role in roles]

    def start() -> str:
        if not system.runs_systemd():
            return "left out: systemd does not run here"
        run("systemctl", "daemon-reload")
        run("systemctl", "enable", *names)
        for name in names:
            run("systemctl", "restart", name)
        return " ".join(names)

    return Step("services", lambda: f"start {' '.join(names)}, now and with the system", start)


def stop(system: System, roles: Sequence[str]) -> str:
    if not system.runs_systemd():
        return "left alone: systemd does not run here"
    names = [unit(role) for role in STOP_ORDER if role in roles]
    run("systemctl", "disable", "--now", *names)
    return " ".join(names)
