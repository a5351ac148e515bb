"""`rce machine --config FILE`: invitations of machines in the database of a Master of this machine, running or not."""

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
from master.access.audit import Audit, Origin
from master.access.enrolment import HOURS, Inviter
from master.access.join_tokens import JoinTokens
from master.storage.store import Store
from rce.api.joining import Role
from rce.api.roles import Principal
from rce.errors import InvalidRequest, RceError
from rce.process import settings

ROLES: tuple[Role, ...] = get_args(Role)
CONFIG = Path("/etc/rce/master.toml")


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    whole = argparse.ArgumentParser(prog="rce machine", description="Machines of the platform.")
    whole.add_argument("--config", type=Path, default=CONFIG, help="the Master's settings (default: %(default)s)")
    commands = whole.add_subparsers(dest="command", required=True)
    add = commands.add_parser("add", help="invite a machine: print a join code, valid once for one machine")
    add.add_argument("name")
    add.add_argument("--role", action="append", choices=ROLES, help="the processes that it runs (default: all)")
    add.add_argument("--address", default="", help="by which others reach it (default: its source address)")
    add.add_argument("--hours", type=float, default=HOURS, help="of validity of the code (default: %(default)g)")
    remove = commands.add_parser("remove", help="revoke the credentials and the certificate of a machine")
    remove.add_argument("name")
    listing = commands.add_parser("list", help="list the machines, whether they run or not")
    listing.add_argument("--json", action="store_true")
    for each in commands.choices.values():  # options are accepted before and after the command
        each.add_argument("--config", type=Path, default=argparse.SUPPRESS, help="the Master's settings")
    return whole


async def run(words: argparse.Namespace) -> None:
    """Run a parsed command.

    Raises:
        RceError: It failed; the message says why.
    """
    options = settings.load(Settings, "rce machine", ["--config", str(words.config)], {})
    store = Store(options.database or f"sqlite:///{options.data_dir / 'master.db'}")
    await store.open()
    audit = Audit(store)
    try:
        if words.command == "list":
            await _act(JoinTokens(store), options, words)
        else:
            with audit.auditing(f"machine.{words.command}", "", words.name, Origin("offline")) as audited:
                audited.who = Principal(f"@{getpass.getuser()}", "admin")  # a user of this machine, not of the platform
                await _act(JoinTokens(store), options, words)
    finally:
        await audit.flush()
        await store.close()


async def _act(processes: JoinTokens, options: Settings, words: argparse.Namespace) -> None:
    match words.command:
        case "add":
            inviter = Inviter.from_settings(processes, options.machines, options.tls, options.address)
            if inviter is None:
                raise InvalidRequest(
                    f"{words.config} lacks the settings `machines` or `tls`: machines cannot join this Master"
                )
            print((await inviter.code(words.name, words.role or ROLES, words.address, words.hours)).text())
        case "remove":
            await processes.remove_machine(words.name)
        case "list":
            names = await processes.names()
            print(msgspec.json.encode(names).decode() if words.json else "\n".join(names))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit status."""
    words = parser().parse_args(arguments)
    try:
        asyncio.run(run(words))
    except (RceError, OSError) as error:
        print(f"rce machine: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
