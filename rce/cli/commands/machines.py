"""`machine`, `group`, `events`: the platform itself."""

from __future__ import annotations

import argparse
import ipaddress
import time
from typing import get_args

from rce.api import views
from rce.api.joining import Role
from rce.cli import output
from rce.cli.arguments import JSON, OF_USER, OF_USER_OR_ALL, argument
from rce.cli.command import Command
from rce.cli.commands.environments import ENVIRONMENTS
from rce.cli.session import ConsoleSession, user_query
from rce.errors import NotFound

MACHINE = argument("machine", completion="machine", metavar="NAME")

MACHINES: output.Columns[views.MachineView] = {
    "machine": lambda each: each.name,
    "role": lambda each: each.role,
    "state": lambda each: each.state,
    "slots": lambda each: f"{each.used}/{each.slots}" if each.slots else None,
    "environments": lambda each: each.environments,
    "robots": lambda each: each.robots,
    "features": lambda each: each.features,
    "url": lambda each: _url(each),
}
STATS: output.Columns[views.MachineView] = {
    "machine": lambda each: each.name,
    "state": lambda each: each.state,
    "slots used": lambda each: each.used,
    "of": lambda each: each.slots,
    "gpus used": lambda each: each.gpusUsed,
    "of gpus": lambda each: each.gpus,
    "environments": lambda each: each.environments,
    "cores used": lambda each: each.usage and each.usage.cores,
    "memory used": lambda each: each.usage and output.size_text(each.usage.memory),
}
GROUPS: output.Columns[views.GroupView] = {
    "group": lambda each: each.group,
    "user": lambda each: each.user,
    "subnet": lambda each: each.subnet,
    "members": lambda each: each.members,
}


def _url(machine: views.MachineView) -> str:
    """Return the URL of a machine; if it has no host, with the machine's first address."""
    return machine.url.replace("://:", f"://{machine.addresses[0] if machine.addresses else '*'}:")


def _machine_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(session.api.items(views.MachineView, "machines"), MACHINES, args.json)


def _machine_show(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_record(session.api.get(views.MachineView, "machines", args.machine), args.json)


def _machine_stats(session: ConsoleSession, args: argparse.Namespace) -> None:
    found = (
        (session.api.get(views.MachineView, "machines", name) for name in _names(session, args.machine))
        if args.machine
        else session.api.items(views.MachineView, "machines", role="container")
    )
    output.print_table(found, STATS, args.json)


def _machine_environments(session: ConsoleSession, args: argparse.Namespace) -> None:
    found = (
        environment
        for name in _names(session, args.machine)
        for environment in session.api.items(views.EnvironmentView, "environments", user="*", machine=name)
    )
    output.print_table(found, ENVIRONMENTS, args.json)


def _names(session: ConsoleSession, machine: str) -> list[str]:
    """Return the names of the task sets at an IP address, by which the original named machines; a name as it is.

    Raises:
        NotFound: No task set has the address.
    """
    try:
        address = str(ipaddress.ip_address(machine))
    except ValueError:
        return [machine]
    sets = session.api.items(views.MachineView, "machines", role="container")
    names = [each.name for each in sets if address in each.addresses]
    if not names:
        raise NotFound(f"no task set has the address {machine}; `machine list` shows the names of all machines")
    return names


def _machine_add(session: ConsoleSession, args: argparse.Namespace) -> None:
    body = views.NewInvitation(args.machine, args.role or list(get_args(Role)), args.address, args.hours)
    print(session.api.post(views.Invited, "machines", "invitations", body=body).code)


def _machine_remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.delete("machines", args.machine)


def _group_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(session.api.items(views.GroupView, "groups", user=user_query(args.of)), GROUPS, args.json)


def _group_show(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_record(session.api.get(views.GroupView, "groups", args.group, user=args.of), args.json)


def _events(session: ConsoleSession, args: argparse.Namespace) -> None:
    import msgspec

    for event in session.api.follow("events", user=user_query(args.of)):
        if args.json:
            print(event.data, flush=True)
            continue
        decoded = msgspec.json.decode(event.data, type=views.Event)
        when = time.strftime("%H:%M:%S", time.localtime(decoded.time))
        print(
            "  ".join(filter(None, [when, f"{decoded.type:18}", decoded.object, decoded.text])),
            *decoded.lines,
            sep="\n    ",
            flush=True,
        )


COMMANDS = (
    Command(
        "machine list", "List the platform's processes on its machines.", _machine_list, (JSON,), ("machine list",)
    ),
    Command("machine show", "Show a machine.", _machine_show, (MACHINE, JSON), ("machine show machine-1",)),
    Command(
        "machine stats",
        "Show capacity and use of machines.",
        _machine_stats,
        (argument("machine", completion="machine", nargs="?", default="", metavar="NAME"), JSON),
        ("machine stats", "machine stats hall-2"),
    ),
    Command(
        "machine environments",
        "List the environments on a machine.",
        _machine_environments,
        (MACHINE, JSON),
        ("machine environments machine-1",),
    ),
    Command(
        "machine add",
        "Invite a machine: prints a join code that admits one machine, once.",
        _machine_add,
        (
            argument("machine", metavar="NAME"),
            argument("--role", action="append", choices=get_args(Role), help="what it may run (default: all)"),
            argument("--address", default="", help="at which others reach it (default: the one it connects from)"),
            argument("--hours", type=float, default=24.0, help="until the code expires (default: %(default)g)"),
        ),
        ("machine add hall-2 --role container",),
    ),
    Command(
        "machine remove",
        "Disconnect a machine for good: its processes and its certificate are refused.",
        _machine_remove,
        (MACHINE,),
        ("machine remove hall-2",),
    ),
    Command("group list", "List network groups.", _group_list, (OF_USER_OR_ALL, JSON), ("group list",)),
    Command(
        "group show",
        "Show a network group with its members' addresses.",
        _group_show,
        (argument("group", completion="group", metavar="GROUP"), OF_USER, JSON),
        ("group show fleet",),
    ),
    Command(
        "events",
        "Print events as they happen, until Ctrl-C.",
        _events,
        (OF_USER_OR_ALL, argument("--json", action="store_true", help="print each event as a line of JSON")),
        ("events", "events --of all --json"),
    ),
)
