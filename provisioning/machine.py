"""Commands `machine` and `cloud-init`: invite other machines, on the Master's machine. Standard library only."""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from provisioning import cloudinit
from provisioning.joincode import parse
from provisioning.services import as_user
from provisioning.steps import ProvisioningError, add_command, need_root, run, start_log
from provisioning.system import CURRENT, ETC, TLS, System

if TYPE_CHECKING:
    from provisioning.steps import Commands


def machine(options: argparse.Namespace, rest: list[str]) -> int:
    """Manage machines of the platform: `add NAME` prints the command to run on a new one; `remove NAME`, `list`."""
    command = [*_rce(), options.action, *([options.name] if options.name else []), *_invitation(options)]
    if options.action != "list" and not options.name:
        raise ProvisioningError(f"machine {options.action} needs the NAME of the machine")
    if options.dry_run:
        print(f"{'run':<16} {shlex.join(command)}")
        return 0
    output = _ask(command)
    if options.action != "add":
        print(output, end="")
        if options.action == "remove":
            print(f"{options.name} cannot join again; its services lose access to the Master within 3 s")
        return 0
    code = parse(output)
    roles = ",".join(code.roles)
    print(f"On the new machine, as root, within {options.hours:g} hours, once:\n")
    print(f"provisioning/provision install --role {roles} --join {code.text}")
    return 0


def cloud_init(options: argparse.Namespace, rest: list[str]) -> int:
    """Print user data that makes a new cloud instance a machine of the platform; see `machine add`."""
    command = [*_rce(), "add", options.name, *_invitation(options)]
    if options.dry_run:
        print(f"{'run':<16} {shlex.join(command)}, and put the code into user data")
        return 0
    code = parse(_ask(command))
    print(cloudinit.user_data(code, Path(TLS, "ca.pem").read_text(), options.install), end="")
    return 0


def add_commands(commands: Commands) -> None:
    """Add the subcommands of this module."""
    command = add_command(commands, machine)
    command.add_argument("action", choices=["add", "remove", "list"])
    command.add_argument("name", nargs="?", help="name of the machine, unique on the platform")
    _add_invitation(command)
    cloud = add_command(commands, cloud_init, name="cloud-init")
    cloud.add_argument("name", help="name of the machine")
    _add_invitation(cloud)
    cloud.add_argument(
        "--install", default="", metavar="OPTIONS", help='options for `install` there, such as "--size 4 --no-images"'
    )


def _add_invitation(command: argparse.ArgumentParser) -> None:
    command.add_argument("--role", action="append", metavar="ROLE", help="robot, container (default: both)")
    command.add_argument("--address", default="", metavar="HOST", help="address of the machine for others")
    command.add_argument(
        "--hours", type=float, default=24.0, help="lifetime of the code in hours (default: %(default)g)"
    )


def _rce() -> list[str]:
    """Return the command `rce machine` as the services' user, who owns the database."""
    return as_user(f"{CURRENT}/bin/rce", "machine", f"--config={ETC}/master.toml")


def _invitation(options: argparse.Namespace) -> list[str]:
    if getattr(options, "action", "add") != "add":
        return []
    roles = [role for text in options.role or () for role in text.split(",")]
    address = [f"--address={options.address}"] if options.address else []
    return [*(f"--role={role}" for role in roles), *address, f"--hours={options.hours:g}"]


def _ask(command: list[str]) -> str:
    if "master" not in System().roles():
        raise ProvisioningError("there is no Master on this machine: run this on the machine where it is installed")
    need_root("machine")
    start_log()
    return run(*command, secret="")
