"""`install`: makes this system a machine of the platform, or all of one. Standard library only."""

from __future__ import annotations

import argparse
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from provisioning import configuration, joincode, notes, release
from provisioning.configuration import Wanted
from provisioning.installing import account_steps, certificate_step, package_step
from provisioning.services import docker_steps, file_steps, image_step, start_step
from provisioning.steps import Failed, Step, add_command, begin_log, need_root, perform, show
from provisioning.system import KNOWN, MAPS, ROLES, SERVICES, System, own_address

if TYPE_CHECKING:
    from provisioning.steps import Commands

OPTIONS = ("address", "http_port", "ws_port", "engine", "allow_unisolated", "size", "certificate", "private_key")


def install(options: argparse.Namespace, rest: list[str]) -> int:
    """Install the platform, or a part of it, as services of this system; again: bring it up to what is asked for."""
    system = System(options.root)
    wanted = wanted_from(options, system)
    steps = install_steps(system, wanted, options)
    if options.dry_run:
        show(steps)
        print("\n" + notes.firewall(wanted))
        return 0
    if options.root != Path("/"):
        raise Failed("--root is for --dry-run: to install there, run this in it (chroot, container)")
    need_root("install")
    begin_log()
    perform(steps)
    print("\n" + notes.after(system, wanted))
    return 0


def add_commands(commands: Commands) -> None:
    command = add_command(commands, install)
    command.add_argument("--root", type=Path, default=Path("/"), metavar="DIR", help="with --dry-run: of this system")
    command.add_argument(
        "--role", action="append", metavar="ROLE", help="master, robot, container or all (default); also several"
    )
    command.add_argument("--join", metavar="CODE", help="join the platform whose `machine add` printed this code")
    command.add_argument("--name", help="of this machine, unique on the platform (default: its host name)")
    command.add_argument("--address", metavar="HOST", help="by which robots and machines reach it (default: its own)")
    command.add_argument(
        "--engine", choices=["docker", "swarm", "process"], help="what runs environments (default: docker)"
    )
    command.add_argument(
        "--allow-unisolated",
        action="store_true",
        default=None,
        help="engine process on a machine that joins another: whoever uses the platform runs programs as its user here",
    )
    command.add_argument("--size", type=int, metavar="N", help="slots for environments (default: 10)")
    command.add_argument("--http-port", type=int, metavar="PORT", help="of the robots' entry (default: 9000)")
    command.add_argument("--ws-port", type=int, metavar="PORT", help="of the robots' WebSockets (default: 9010)")
    command.add_argument("--certificate", metavar="FILE", help="PEM that robots see (default: of the machine's own CA)")
    command.add_argument("--private-key", metavar="FILE", help="PEM file of its key")
    command.add_argument("--no-images", action="store_true", help="build no images for the engine docker")
    command.add_argument("--no-start", action="store_true", help="do not start the services")


def wanted_from(options: argparse.Namespace, system: System) -> Wanted:
    """What the options ask for; what they leave open is as it is here already, else the default. Failed."""
    code = joincode.parse(options.join) if options.join else None
    installed = system.roles()
    roles = _roles(options.role) or (code.roles if code else installed or ROLES)
    with_maps = {*roles, *installed, *([MAPS] if "master" in roles else [])}
    if code is not None and not set(roles) <= set(code.roles):
        raise Failed(f"this join code is for {', '.join(code.roles)}: make one for {', '.join(roles)}, or leave --role")
    if code is not None and "master" in installed:
        raise Failed("this machine has a Master of its own; `provisioning/provision uninstall` removes it")
    if "master" not in roles and code is None and not installed:
        raise Failed("robot and container need a Master: give the --join CODE that `machine add` printed there")
    if bool(options.certificate) != bool(options.private_key):
        raise Failed("--certificate and --private-key go together")
    found = {role: configuration.read(system, role) for role in installed}
    _check_isolation(options, roles, code is not None)
    given = {name: getattr(options, name) for name in OPTIONS}
    engine = str(options.engine or found.get("container", {}).get("engine", "docker"))
    name = code.name if code else options.name or found.get("container", {}).get("name") or socket.gethostname()
    address = options.address or found.get("master", {}).get("address") or own_address()
    # What is here stays: another role is added to it.
    merged = tuple(role for role in SERVICES if role in with_maps)
    wanted = Wanted(merged, str(name), str(address), {**given, "engine": engine}, code)
    notes.check(wanted)
    return wanted


def _check_isolation(options: argparse.Namespace, roles: Sequence[str], joins: bool) -> None:
    if "container" in roles and joins and options.engine == "process" and not options.allow_unisolated:
        raise Failed(
            "the engine process lets users of a platform elsewhere run programs as one user of this machine: "
            "use --engine docker, or --allow-unisolated if they are all your own"
        )


def _roles(given: Sequence[str] | None) -> tuple[str, ...]:
    asked = [role for text in given or () for role in text.split(",")]
    if wrong := set(asked) - {*ROLES, "all"}:
        raise Failed(f"there is no role {', '.join(sorted(wrong))}: choose of {', '.join(ROLES)}, all")
    return ROLES if "all" in asked else tuple(role for role in ROLES if role in asked)


def install_steps(system: System, wanted: Wanted, options: argparse.Namespace) -> list[Step]:
    """All that makes the system what is wanted, in order."""
    if system.release() not in KNOWN:
        known = ", ".join(" ".join(each) for each in sorted(KNOWN))
        raise Failed(f"this is {' '.join(system.release()) or 'an unknown system'}; provision knows {known}")
    extras = release.extras(wanted.roles, wanted.engine)
    steps = [
        package_step(system, wanted),
        *account_steps(system, wanted.roles),
        *release.release_steps(system, extras),
        release.switch_step(system, extras),
    ]
    if "container" in wanted.roles and not wanted.uses_docker:
        steps.append(release.typesupport_step(system))
    steps += [certificate_step(system, wanted), *file_steps(system, wanted)]
    if "container" in wanted.roles and wanted.uses_docker:
        steps += docker_steps(system)
        if not options.no_images:
            steps.append(image_step())
    if not options.no_start:
        steps.append(start_step(system, wanted.roles))
    return steps
