"""Command `install`: makes this system a machine of the platform. Standard library only."""

from __future__ import annotations

import argparse
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from provisioning import configuration, joincode, release, summary
from provisioning.configuration import Installation
from provisioning.services import docker_steps, file_steps, image_step, start_step
from provisioning.steps import ProvisioningError, Step, add_command, need_root, print_plan, run_steps, start_log
from provisioning.system import KNOWN, ROLES, SERVICES, WEB_SERVICES, System, own_address
from provisioning.system_steps import account_steps, certificate_step, package_step

if TYPE_CHECKING:
    from provisioning.steps import Commands

OPTIONS = (
    *("address", "http_port", "ws_port", "engine", "allow_unisolated", "size", "certificate", "private_key"),
    *("database", "masters"),
)


def install(options: argparse.Namespace, rest: list[str]) -> int:
    """Install the platform or a part of it as services of this system, or change an installation."""
    system = System(options.root)
    installation = planned_installation(options, system)
    steps = install_steps(system, installation, options)
    if options.dry_run:
        print_plan(steps)
        print("\n" + summary.firewall_ports(installation))
        return 0
    if options.root != Path("/"):
        raise ProvisioningError(
            "--root works with --dry-run only: to install in that directory, run this command in it (chroot, container)"
        )
    need_root("install")
    start_log()
    run_steps(steps)
    print("\n" + summary.next_steps(system, installation))
    return 0


def add_commands(commands: Commands) -> None:
    """Add the subcommand `install`."""
    command = add_command(commands, install)
    command.add_argument(
        "--root", type=Path, default=Path("/"), metavar="DIR", help="with --dry-run: root directory of the system"
    )
    command.add_argument(
        "--role", action="append", metavar="ROLE", help="master, robot, container or all (default); may be repeated"
    )
    command.add_argument("--join", metavar="CODE", help="join the platform whose `machine add` printed this code")
    command.add_argument("--name", help="name of this machine, unique on the platform (default: host name)")
    command.add_argument("--address", metavar="HOST", help="address for robots and other machines (default: its own)")
    command.add_argument(
        "--engine", choices=["docker", "swarm", "process"], help="engine of environments (default: docker)"
    )
    command.add_argument(
        "--allow-unisolated",
        action="store_true",
        default=None,
        help="allow the engine process on a machine that joins a platform: its users run programs as one user here",
    )
    command.add_argument("--size", type=int, metavar="N", help="slots for environments (default: 10)")
    command.add_argument("--http-port", type=int, metavar="PORT", help="port of the robots' entry (default: 9000)")
    command.add_argument("--ws-port", type=int, metavar="PORT", help="port of the robots' WebSockets (default: 9010)")
    command.add_argument(
        "--certificate",
        metavar="FILE",
        help="PEM file of the certificate for robots (default: by the machine's own CA)",
    )
    command.add_argument("--private-key", metavar="FILE", help="PEM file of its key")
    command.add_argument(
        "--database", metavar="URL", help="PostgreSQL for the Master, as `postgresql` prints it (default: SQLite)"
    )
    command.add_argument(
        "--masters",
        metavar="HOSTS",
        help="addresses of all Masters of the platform, comma-separated: the first has its services, too",
    )
    command.add_argument("--no-images", action="store_true", help="build no images for the engine docker")
    command.add_argument("--no-start", action="store_true", help="do not start the services")


def planned_installation(options: argparse.Namespace, system: System) -> Installation:
    """Return the desired installation: by the options, else as installed, else by default.

    Raises:
        ProvisioningError: The options contradict each other or the installation.
    """
    code = joincode.parse(options.join) if options.join else None
    installed = system.roles()
    roles = _roles(options.role) or (code.roles if code else installed or ROLES)
    if code is not None and not set(roles) <= set(code.roles):
        raise ProvisioningError(
            f"this join code is for {', '.join(code.roles)}: make one for {', '.join(roles)}, or omit --role"
        )
    if code is not None and "master" in installed:
        raise ProvisioningError("this machine has a Master of its own; `provisioning/provision uninstall` removes it")
    if "master" not in roles and code is None and not installed:
        raise ProvisioningError(
            "robot and container need a Master: add --join with the code that `machine add` printed there"
        )
    if bool(options.certificate) != bool(options.private_key):
        raise ProvisioningError("--certificate and --private-key go together")
    found = {role: configuration.read(system, role) for role in installed}
    _check_isolation(options, roles, code is not None)
    given = {name: getattr(options, name) for name in OPTIONS}
    engine = str(options.engine or found.get("container", {}).get("engine", "docker"))
    name = code.name if code else options.name or found.get("container", {}).get("name") or socket.gethostname()
    address = options.address or found.get("master", {}).get("address") or own_address()
    masters = _masters(options, found.get("master", {}), str(address))
    with_services = {*roles, *installed}
    if "master" in roles and (not masters or masters[0] == address):
        with_services |= set(WEB_SERVICES)
    # Roles that are installed already are kept.
    merged = tuple(role for role in SERVICES if role in with_services)
    installation = Installation(merged, str(name), str(address), {**given, "engine": engine}, code)
    summary.check_ports(installation)
    return installation


def _masters(options: argparse.Namespace, found: configuration.Settings, address: str) -> list[str]:
    """Return the hosts of all Masters, if there are several.

    Raises:
        ProvisioningError: They have no database that they can share, or this machine is none of them.
    """
    if not options.masters:
        kept = found.get("masters", [])
        return kept if isinstance(kept, list) else []
    masters = configuration.masters(options.masters)
    if not str(options.database or found.get("database", "")).startswith("postgresql"):
        raise ProvisioningError("several Masters share a PostgreSQL: add --database with the URL of it")
    if address not in masters:
        raise ProvisioningError(f"--masters has not the address of this machine, {address}: see --address")
    return masters


def _check_isolation(options: argparse.Namespace, roles: Sequence[str], joins: bool) -> None:
    if "container" in roles and joins and options.engine == "process" and not options.allow_unisolated:
        raise ProvisioningError(
            "the engine process lets users of that platform run programs as one user of this machine: "
            "use --engine docker, or --allow-unisolated if you trust them all"
        )


def _roles(given: Sequence[str] | None) -> tuple[str, ...]:
    asked = [role for text in given or () for role in text.split(",")]
    if wrong := set(asked) - {*ROLES, "all"}:
        raise ProvisioningError(f"there is no role {', '.join(sorted(wrong))}: choose from {', '.join(ROLES)}, all")
    return ROLES if "all" in asked else tuple(role for role in ROLES if role in asked)


def install_steps(system: System, installation: Installation, options: argparse.Namespace) -> list[Step]:
    """Return the steps that bring the system to the desired state.

    Raises:
        ProvisioningError: The operating system is not supported.
    """
    if system.release() not in KNOWN:
        known = ", ".join(" ".join(each) for each in sorted(KNOWN))
        raise ProvisioningError(
            f"this is {' '.join(system.release()) or 'an unknown system'}; provision supports {known}"
        )
    database = installation.option("database", str(configuration.read(system, "master").get("database", "")))
    extras = release.required_extras(installation.roles, installation.engine, database)
    steps = [
        package_step(system, installation),
        *account_steps(system, installation.roles),
        *release.release_steps(system, extras),
        release.switch_step(system, extras),
    ]
    if "container" in installation.roles and not installation.uses_docker:
        steps.append(release.typesupport_step(system))
    steps += [certificate_step(system, installation), *file_steps(system, installation)]
    if "container" in installation.roles and installation.uses_docker:
        steps += docker_steps(system)
        if not options.no_images:
            steps.append(image_step())
    if not options.no_start:
        steps.append(start_step(system, installation.roles))
    return steps
