"""Commands `upgrade` and `uninstall`. Standard library only."""

from __future__ import annotations

import argparse
import os
import pwd
import shutil
import signal
import sqlite3
import sys
import time
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from provisioning import install as installer
from provisioning import release
from provisioning.services import START_ORDER, SYSCTL, stop
from provisioning.steps import ProvisioningError, Step, add_command, need_root, print_plan, run, run_steps, start_log
from provisioning.system import ETC, OPT, UNITS, USER, VAR, System, docker_answers, program, unit

if TYPE_CHECKING:
    from provisioning.steps import Commands

BACKUPS = f"{VAR}/backup"
IMAGES = ("rce/base", "rce/mapping", "rce/mapping3d", "rce/ground", "rce/system")
LOCKS = "/tmp/rce-domains"  # locks of ROS domains, by the engine process
STOP_TIMEOUT = 10.0  # seconds for processes to end


def upgrade(options: argparse.Namespace, rest: list[str]) -> int:
    """Replace the installed release by this checkout. Database, environments and robots' sessions are kept."""
    system = System()
    if not system.roles():
        raise ProvisioningError("nothing is installed here: provisioning/provision install")
    installation = installer.planned_installation(_no_options(), system)
    steps = installer.install_steps(system, installation, options)
    at = next(index for index, step in enumerate(steps) if step.name == "current release")
    steps[at:at] = [_backup_step(system)] if "master" in installation.roles else []
    if options.dry_run:
        print_plan(steps)
        return 0
    need_root("upgrade")
    start_log()
    before = release.installed_release(system)
    run_steps(steps)
    print(f"\n{before} -> {release.installed_release(system)}")
    if not system.runs_systemd():
        print(f"systemd does not run here: restart by hand, in this order: {' '.join(START_ORDER)}")
    return 0


def uninstall(options: argparse.Namespace, rest: list[str]) -> int:
    """Remove the platform from this system. Settings and data are kept unless --purge is given or you agree."""
    system = System()
    purge = options.purge or (not options.dry_run and _confirm_purge(system))
    steps = uninstall_steps(system, purge)
    if options.dry_run:
        print_plan(steps)
        return 0
    need_root("uninstall")
    start_log()
    run_steps(steps)
    if not purge:
        print(f"\nkept: {ETC} {VAR} and the user {USER}; provisioning/provision uninstall --purge removes them too")
    print("Packages of the system (docker.io and others) are not removed.")
    return 0


def add_commands(commands: Commands) -> None:
    """Add the subcommands of this module."""
    command = add_command(commands, upgrade)
    command.add_argument("--no-images", action="store_true", help="build no images for the engine docker")
    command.add_argument("--no-start", action="store_true", help="do not restart the services")
    command = add_command(commands, uninstall)
    command.add_argument("--purge", action="store_true", help="also remove settings, data, images and the user")


def _no_options() -> argparse.Namespace:
    """Return options of `install` that keep everything as it is installed."""
    return argparse.Namespace(role=None, join=None, name=None, **dict.fromkeys(installer.OPTIONS))


# --- upgrade ----------------------------------------------------------------------------------------------------------


def _backup_step(system: System) -> Step:
    database = system.path(f"{VAR}/master/master.db")
    target = system.path(f"{BACKUPS}/master-{release.installed_release(system)}.db")
    todo = f"the Master's database to {target}" if database.exists() else ""

    def save() -> str:
        target.parent.mkdir(mode=0o700, exist_ok=True)
        with closing(sqlite3.connect(database)) as source, closing(sqlite3.connect(target)) as copy:
            source.backup(copy)  # a consistent copy, even while the Master writes
        target.chmod(0o600)
        return str(target)

    return Step("backup", lambda: todo, save)


# --- uninstall --------------------------------------------------------------------------------------------------------


def _confirm_purge(system: System) -> bool:
    if not sys.stdin.isatty() or not system.path(ETC).exists():
        return False
    answer = input(f"Keep settings, certificates, users and data ({ETC}, {VAR})? [Y/n] ")
    return answer.strip().lower() in ("n", "no")


def uninstall_steps(system: System, purge: bool) -> list[Step]:
    """Return the steps that remove the installation, in reverse order."""
    roles = system.roles()
    names = [f"{UNITS}/{unit(role)}" for role in START_ORDER]
    steps = [
        Step("services", lambda: f"stop {' '.join(map(unit, roles))}" if roles else "", lambda: stop(system, roles)),
        Step("containers", lambda: "remove environments" if docker_answers() else "", _remove_containers),
        Step("processes", lambda: f"end processes of {USER}" if system.has_user() else "", _end_processes),
        _remove_step(system, "units", names),
        _remove_step(system, "kernel", [SYSCTL]),
        _remove_step(system, "code", [OPT]),
    ]
    if not purge:
        return steps
    return [
        *steps,
        Step("images", lambda: "remove " + " ".join(IMAGES) if docker_answers() else "", _remove_images),
        _remove_step(system, "settings and data", [ETC, VAR, LOCKS]),
        Step("user", lambda: f"remove {USER}" if system.has_user() else "", _remove_user),
    ]


def _remove_step(system: System, name: str, places: list[str]) -> Step:
    present = [place for place in places if system.path(place).exists()]

    def remove() -> str:
        for place in present:
            path = system.path(place)
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()
        if name == "units" and system.runs_systemd():
            run("systemctl", "daemon-reload")
        return " ".join(present)

    return Step(name, lambda: " ".join(present), remove)


def _remove_containers() -> str:
    found = run("docker", "ps", "-aq", "--filter", "label=rce.platform").split()
    if found:
        run("docker", "rm", "-f", *found)
    networks = run("docker", "network", "ls", "-q", "--filter", "label=rce.platform").split()
    if networks:
        run("docker", "network", "rm", *networks)
    return f"{len(found)} removed"


def _remove_images() -> str:
    found = [image for name in IMAGES for image in run("docker", "images", "-q", name).split()]
    if found:
        run("docker", "rmi", "-f", *dict.fromkeys(found))
    return f"{len(found)} removed"


def _end_processes() -> str:
    """End the processes of environments, which outlive their task set under the engine `process`."""
    owner = pwd.getpwnam(USER).pw_uid
    total = len(list(_processes(owner)))
    until = time.monotonic() + STOP_TIMEOUT
    for number in (signal.SIGTERM, signal.SIGKILL):
        for process in _processes(owner):
            with suppress(ProcessLookupError):
                os.kill(process, number)
        while any(_processes(owner)) and time.monotonic() < until:
            time.sleep(0.1)
    return f"{total} ended"


def _processes(owner: int) -> Iterator[int]:
    """Yield a user's processes, without those in containers, which have another root directory."""
    own = os.stat("/")
    for path in Path("/proc").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError, PermissionError):
            if path.name.isdecimal() and path.stat().st_uid == owner and os.path.samestat(own, os.stat(path / "root")):
                yield int(path.name)


def _remove_user() -> str:
    run(program("userdel") or "userdel", USER)
    return USER
