"""Later steps of `install`: settings, units, administrator, Docker, images, start of the services.

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
from provisioning.configuration import Installation
from provisioning.steps import ROOT, Step, run
from provisioning.system import CURRENT, ETC, UNITS, USER, VAR, System, docker_answers, unit

PASSWORD = f"{ETC}/admin-password"
SYSCTL, RMEM_MAX = "/etc/sysctl.d/60-rce.conf", "/proc/sys/net/core/rmem_max"
RECEIVE_BUFFER = 4 * 1024 * 1024  # as the endpoint requests
STOP_ORDER = ("knowledge-service", "map-service", "container", "robot", "master")
START_ORDER = tuple(reversed(STOP_ORDER))  # preferred, not required: the others wait for the Master


def file_steps(system: System, installation: Installation) -> list[Step]:
    """Return the steps that write settings and units and make the first user."""
    return [
        Step(
            "settings",
            lambda: " ".join(_stale_settings(system, installation)),
            lambda: _write_settings(system, installation),
        ),
        Step("units", lambda: " ".join(_stale_units(system, installation)), lambda: _write_units(system, installation)),
        *([_administrator_step(system, installation)] if "master" in installation.roles else []),
    ]


def _settings(system: System, installation: Installation) -> dict[str, str]:
    """Return the text of each settings file whose values change."""
    values = configuration.settings(installation, system)
    return {
        f"{ETC}/{role}.toml": configuration.text(role, values[role])
        for role in installation.roles
        if values[role] != configuration.read(system, role)
    }


def _stale_settings(system: System, installation: Installation) -> list[str]:
    return list(_settings(system, installation))


def _write_settings(system: System, installation: Installation) -> str:
    texts = _settings(system, installation)
    for name, text in texts.items():
        system.write(name, text, 0o640, USER)
    return " ".join(texts)


def _units(system: System, installation: Installation) -> dict[str, str]:
    texts = {f"{UNITS}/{unit(role)}": units.text(role, installation.engine) for role in installation.roles}
    return {name: text for name, text in texts.items() if not system.file_is(name, text)}


def _stale_units(system: System, installation: Installation) -> list[str]:
    return list(_units(system, installation))


def _write_units(system: System, installation: Installation) -> str:
    texts = _units(system, installation)
    for name, text in texts.items():
        system.path(name).parent.mkdir(parents=True, exist_ok=True)
        system.write(name, text, 0o644)
    return " ".join(texts)


# --- the administrator ------------------------------------------------------------------------------------------------


def as_user(*command: str) -> list[str]:
    """Return a command that runs as the services' user."""
    return ["runuser", "-u", USER, "--", *command]


def _administrator_step(system: System, installation: Installation) -> Step:
    """Make the administrator before the Master's first start, which would print a password into the journal."""
    database = system.path(f"{VAR}/master/master.db")
    url = str(configuration.settings(installation, system)["master"].get("database", ""))
    environment = {"RCE_DATABASE": url} if url else {}  # the command line, which others can see, has no password
    users = as_user(f"{CURRENT}/bin/rce", "user", f"--data-dir={VAR}/master")

    def add() -> str:
        if url and not run(*users, "list", "--json", environment=environment, secret="").strip().endswith("[]"):
            return "kept"
        password = secrets.token_urlsafe(15)
        run(*users, "add", "admin", "--role", "admin", "--create", environment=environment, secret=password + "\n")
        system.write(PASSWORD, password + "\n", 0o600)
        return f"user admin, password in {PASSWORD}"

    todo = f"user admin, password in {PASSWORD}"
    if url:
        return Step("administrator", lambda: f"{todo}, unless the database has users", add)
    return Step("administrator", lambda: "" if has_users(str(database)) else todo, add)


def has_users(database: str) -> bool:
    """Return True if the Master's database exists and has users."""
    if not os.path.exists(database):
        return False
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
        try:
            return bool(connection.execute("SELECT count(*) FROM users").fetchone()[0])
        except sqlite3.OperationalError:
            return False


# --- Docker -----------------------------------------------------------------------------------------------------------


def kernel_step(system: System) -> Step:
    """Return the step that raises the limit of receive buffers, for bursts of large messages in network groups."""

    def write() -> str:
        system.path(SYSCTL).parent.mkdir(exist_ok=True)
        system.write(SYSCTL, f"# Large messages in network groups.\nnet.core.rmem_max = {RECEIVE_BUFFER}\n", 0o644)
        if receive_buffer() >= RECEIVE_BUFFER:
            return SYSCTL
        try:
            Path(RMEM_MAX).write_text(str(RECEIVE_BUFFER))
        except OSError:
            return f"{SYSCTL}, effective after the next boot"
        return SYSCTL

    todo = "" if system.path(SYSCTL).exists() else f"{SYSCTL}: net.core.rmem_max = {RECEIVE_BUFFER}"
    return Step("kernel", lambda: todo, write)


def receive_buffer() -> int:
    """Return the limit of sockets' receive buffers in bytes, or 0 if it is unknown."""
    try:
        return int(Path(RMEM_MAX).read_text())
    except OSError:
        return 0


def docker_steps(system: System) -> list[Step]:
    """Return the steps that prepare the kernel and start Docker, now and at boot."""

    def start() -> str:
        if not system.runs_systemd():
            return "not started: systemd does not run here; start dockerd by hand"
        run("systemctl", "enable", "--now", "docker.service")
        return "docker.service"

    return [
        kernel_step(system),
        Step("docker", lambda: "" if docker_answers() else "start it, now and at boot", start),
    ]


def image_step() -> Step:
    """Return the step that builds the images of environments from this checkout."""

    def build() -> str:
        if not docker_answers():
            return "skipped: Docker does not answer; build them later by provisioning/provision image"
        python = f"{CURRENT}/bin/python"
        output = run(python, "-P", "-m", "provisioning.image", environment={"PYTHONPATH": str(ROOT)})
        return output.strip().splitlines()[-1]

    return Step("images", lambda: "build what is not in Docker's cache", build)


# --- start and stop ---------------------------------------------------------------------------------------------------


def start_step(system: System, roles: Collection[str]) -> Step:
    """Return the step that starts services, or restarts them with the current release and settings."""
    names = [unit(role) for role in START_ORDER if role in roles]

    def start() -> str:
        if not system.runs_systemd():
            return "skipped: systemd does not run here"
        run("systemctl", "daemon-reload")
        run("systemctl", "enable", *names)
        for name in names:
            run("systemctl", "restart", name)
        return " ".join(names)

    return Step("services", lambda: f"start {' '.join(names)}, now and at boot", start)


def stop(system: System, roles: Sequence[str]) -> str:
    """Stop services, and do not start them at boot any more."""
    if not system.runs_systemd():
        return "skipped: systemd does not run here"
    names = [unit(role) for role in STOP_ORDER if role in roles]
    run("systemctl", "disable", "--now", *names)
    return " ".join(names)
