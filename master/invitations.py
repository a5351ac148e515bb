"""`rce machine`: invites machines, straight in the database of a Master on this machine, running or not."""

from __future__ import annotations

import argparse
import asyncio
import getpass
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import msgspec

from master.__main__ import Settings
from master.audit import Audit, Origin
from master.machines import HOURS, Inviter
from master.processes import Processes
from master.store import Store
from rce import settings
from rce.errors import InvalidRequest, RceError
from rce.joining import Role, process_name
from rce.roles import Principal

ROLES: tuple[Role, ...] = get_args(Role)
CONFIG = Path("/etc/rce/master.toml")


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(prog="rce machine", description="Machines of the platform.")
    whole.add_argument("--config", type=Path, default=CONFIG, help="the Master's settings (default: %(default)s)")
    commands = whole.add_subparsers(dest="command", required=True)
    add = commands.add_parser("add", help="invite a machine: prints a code that is good for one machine, once")
    add.add_argument("name")
    add.add_argument("--role", action="append", choices=ROLES, help="what it shall run (default: all)")
    add.add_argument("--address", default="", help="by which others reach it (default: the one that it comes from)")
    add.add_argument("--hours", type=float, default=HOURS, help="for which the code is good (default: %(default)g)")
    remove = commands.add_parser("remove", help="let a machine join no more")
    remove.add_argument("name")
    listing = commands.add_parser("list", help="list the machines, whether they run or not")
    listing.add_argument("--json", action="store_true")
    for each in commands.choices.values():  # before the command or after it
        each.add_argument("--config", type=Path, default=argparse.SUPPRESS, help="the Master's settings")
    return whole


async def run(words: argparse.Namespace) -> None:
    options = settings.load(Settings, "rce machine", ["--config", str(words.config)], {})
    store = Store(options.database or f"sqlite:///{options.data_dir / 'master.db'}")
    await store.open()
    audit = Audit(store)
    try:
        if words.command == "list":
            await _act(Processes(store), options, words)
        else:
            with audit.noting(f"machine.{words.command}", "", words.name, Origin("offline")) as noted:
                noted.who = Principal(f"@{getpass.getuser()}", "admin")  # of this machine, not of the platform
                await _act(Processes(store), options, words)
    finally:
        await audit.flush()
        await store.close()


async def _act(processes: Processes, options: Settings, words: argparse.Namespace) -> None:
    match words.command:
        case "add":
            inviter = Inviter.of(processes, options.machines, options.tls, options.address)
            if inviter is None:
                raise InvalidRequest(
                    f"{words.config} lacks the settings `machines` or `tls`: this Master takes no machines in"
                )
            print((await inviter.code(words.name, words.role or ROLES, words.address, words.hours)).text())
        case "remove":
            for role in ROLES:
                await processes.forget(process_name(words.name, role))
            await processes.forget(words.name)
        case "list":
            names = await processes.names()
            print(msgspec.json.encode(names).decode() if words.json else "\n".join(names))


def main(arguments: Sequence[str] | None = None) -> int:
    words = parser().parse_args(arguments)
    try:
        asyncio.run(run(words))
    except (RceError, OSError) as error:
        print(f"rce machine: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
