"""`machine`, `group`, `events`, `job`: the platform itself."""

from __future__ import annotations

import argparse
import time
from typing import get_args

from rce import views
from rce.console import show
from rce.console.command import JSON, LISTED, OF, Command, argument
from rce.console.environments import ENVIRONMENTS
from rce.console.session import Session, whose
from rce.joining import Role

MACHINE = argument("machine", live="machine", metavar="NAME")

MACHINES: show.Columns[views.MachineView] = {
    "machine": lambda each: each.name,
    "role": lambda each: each.role,
    "state": lambda each: each.state,
    "slots": lambda each: f"{each.used}/{each.slots}" if each.slots else None,
    "environments": lambda each: each.environments,
    "robots": lambda each: each.robots,
    "features": lambda each: each.features,
    "url": lambda each: each.url,
}
STATS: show.Columns[views.MachineView] = {
    "machine": lambda each: each.name,
    "state": lambda each: each.state,
    "slots used": lambda each: each.used,
    "of": lambda each: each.slots,
    "gpus used": lambda each: each.gpusUsed,
    "of gpus": lambda each: each.gpus,
    "environments": lambda each: each.environments,
    "cores used": lambda each: each.usage and each.usage.cores,
    "memory used": lambda each: each.usage and show.amount(each.usage.memory),
}
GROUPS: show.Columns[views.GroupView] = {
    "group": lambda each: each.group,
    "user": lambda each: each.user,
    "subnet": lambda each: each.subnet,
    "members": lambda each: each.members,
}


def machine_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(session.api.items(views.MachineView, "machines"), MACHINES, words.json)


def machine_show(session: Session, words: argparse.Namespace) -> None:
    show.one(session.api.get(views.MachineView, "machines", words.machine), words.json)


def machine_stats(session: Session, words: argparse.Namespace) -> None:
    found = (
        iter([session.api.get(views.MachineView, "machines", words.machine)])
        if words.machine
        else session.api.items(views.MachineView, "machines", role="container")
    )
    show.rows(found, STATS, words.json)


def machine_environments(session: Session, words: argparse.Namespace) -> None:
    found = session.api.items(views.EnvironmentView, "environments", user="*", machine=words.machine)
    show.rows(found, ENVIRONMENTS, words.json)


def machine_add(session: Session, words: argparse.Namespace) -> None:
    body = views.NewInvitation(words.machine, words.role or list(get_args(Role)), words.address, words.hours)
    print(session.api.post(views.Invited, "machines", "invitations", body=body).code)


def group_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(session.api.items(views.GroupView, "groups", user=whose(words.of)), GROUPS, words.json)


def group_show(session: Session, words: argparse.Namespace) -> None:
    show.one(session.api.get(views.GroupView, "groups", words.group, user=words.of), words.json)


def events(session: Session, words: argparse.Namespace) -> None:
    import msgspec

    for event in session.api.follow("events", user=whose(words.of)):
        if words.json:
            print(event.data, flush=True)
            continue
        told = msgspec.json.decode(event.data, type=views.Event)
        when = time.strftime("%H:%M:%S", time.localtime(told.time))
        print(
            "  ".join(filter(None, [when, f"{told.type:18}", told.object, told.text])),
            *told.lines,
            sep="\n    ",
            flush=True,
        )


def job_list(session: Session, words: argparse.Namespace) -> None:
    from rce.client.map_service import MapService
    from rce.commands.map_jobs import show as show_jobs

    access = session.access
    service = MapService(access.url, user=access.user, password=access.password, key=access.key)
    show_jobs(service.jobs(), words.json)


COMMANDS = (
    Command("machine list", "List the platform's processes on its machines.", machine_list, (JSON,), ("machine list",)),
    Command("machine show", "Show one of them.", machine_show, (MACHINE, JSON), ("machine show machine-1",)),
    Command(
        "machine stats",
        "What machines have and what of it is used.",
        machine_stats,
        (argument("machine", live="machine", nargs="?", default="", metavar="NAME"), JSON),
        ("machine stats", "machine stats hall-2"),
    ),
    Command(
        "machine environments",
        "The environments on a machine.",
        machine_environments,
        (MACHINE, JSON),
        ("machine environments machine-1",),
    ),
    Command(
        "machine add",
        "Invite a machine: prints a join code that is good for one machine, once.",
        machine_add,
        (
            argument("machine", metavar="NAME"),
            argument("--role", action="append", choices=get_args(Role), help="what it shall run (default: all)"),
            argument("--address", default="", help="by which others reach it (default: the one that it comes from)"),
            argument("--hours", type=float, default=24.0, help="for which the code is good (default: %(default)g)"),
        ),
        ("machine add hall-2 --role container",),
    ),
    Command("group list", "List network groups.", group_list, (LISTED, JSON), ("group list",)),
    Command(
        "group show",
        "Show a network group with its members' addresses.",
        group_show,
        (argument("group", live="group", metavar="GROUP"), OF, JSON),
        ("group show fleet",),
    ),
    Command(
        "events",
        "Print what happens, as it does, until Ctrl-C.",
        events,
        (LISTED, argument("--json", action="store_true", help="a line of JSON each")),
        ("events", "events --of all --json"),
    ),
    Command("job list", "List your jobs of the map service.", job_list, (JSON,), ("job list",)),
)
