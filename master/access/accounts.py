"""`rce user --data-dir DIR`: users and API keys in the database of a Master of this machine, running or not."""

from __future__ import annotations

import argparse
import asyncio
import getpass
import os
import sys
import time
from pathlib import Path
from typing import get_args

import msgspec

from master.access.audit import Audit, Origin
from master.access.passwords import check_password
from master.access.user_limits import UserLimits
from master.access.users import Users
from master.graph.limits import NO_LIMIT, parse
from master.storage.directory import DATABASE, existing_master_directory, master_directory
from master.storage.store import Store
from rce.api.roles import Principal, Scopes, UserRole
from rce.errors import NotFound, RceError

DAY = 86_400.0
MAX_DAYS = 36_500.0
ADD_IMAGE = "images+="


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    whole = argparse.ArgumentParser(prog="rce user", description="Users and API keys of a Master on this machine.")
    _add_database_options(whole, Path("~/.local/share/rce/master"), os.environ.get("RCE_DATABASE", ""))
    commands = whole.add_subparsers(dest="command", required=True)
    add = commands.add_parser("add", help="add a user; the password is asked for, or read from standard input")
    add.add_argument("user")
    add.add_argument("--role", choices=get_args(UserRole), default="user")
    add.add_argument("--create", action="store_true", help="make the database of a Master that was never started")
    passwd = commands.add_parser("passwd", help="change a user's password; it is asked for as by `add`")
    passwd.add_argument("user")
    remove = commands.add_parser("remove", help="remove a user with all API keys")
    remove.add_argument("user")
    listing = commands.add_parser("list", help="list the users")
    listing.add_argument("--json", action="store_true")
    limits = commands.add_parser("limits", help="show or change the limits of a user")
    limits.add_argument("user")
    limits.add_argument(
        "changes",
        nargs="*",
        metavar="key=value",
        help="as memory=2GiB; `memory=-` is no limit; `memory=` resets it to the platform's; images+=NAME",
    )
    limits.add_argument("--json", action="store_true")
    key_add = commands.add_parser("key-add", help="create an API key and print it; it is shown only once")
    key_add.add_argument("user")
    key_add.add_argument("--role", choices=get_args(UserRole), default="robot")
    key_add.add_argument("--label", default="")
    key_add.add_argument("--days", type=days, help="days until it expires")
    key_add.add_argument("--robot", default="", help="the only robotID for which it is valid")
    key_add.add_argument("--environment", action="append", default=[], help="its only environments; repeatable")
    key_list = commands.add_parser("key-list", help="list a user's API keys")
    key_list.add_argument("user")
    key_list.add_argument("--json", action="store_true")
    key_revoke = commands.add_parser("key-revoke", help="revoke an API key")
    key_revoke.add_argument("user")
    key_revoke.add_argument("key", help="its id, as `key-list` shows it")
    for each in commands.choices.values():  # options are accepted before and after the command
        _add_database_options(each, argparse.SUPPRESS, argparse.SUPPRESS)
    return whole


def _add_database_options(to: argparse.ArgumentParser, directory: Path | str, database: str) -> None:
    to.add_argument("--data-dir", type=Path, default=directory, help="data directory of the Master, or of `rce up`")
    to.add_argument("--database", default=database, help="SQLAlchemy URL, if the Master's is not in its data directory")


def days(text: str) -> float:
    """Return a number of days from the command line; argparse reports a ValueError."""
    number = float(text)
    if not 0 < number <= MAX_DAYS:
        raise argparse.ArgumentTypeError(f"{text} is not above 0 and at most {MAX_DAYS:g}")
    return number


def _password() -> str:
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    try:
        first = getpass.getpass("Password: ")
        if getpass.getpass("Again: ") != first:
            raise RceError("the passwords differ")
    except EOFError:  # Ctrl-D
        raise RceError("no password was given") from None
    return first


ACTIONS = {
    "add": "user.create",
    "passwd": "password.change",
    "remove": "user.remove",
    "limits": "limits.change",
    "key-add": "key.create",
    "key-revoke": "key.revoke",
}
"""Operation of each command that changes something, for the audit log."""


async def run(words: argparse.Namespace) -> None:
    """Run a parsed command.

    Raises:
        RceError: It failed; the message says why.
    """
    store = Store(words.database or f"sqlite:///{_directory(words) / DATABASE}")
    await store.open()
    try:
        await _run_audited(store, words)
    finally:
        await store.close()


def _directory(words: argparse.Namespace) -> Path:
    given: Path = words.data_dir.expanduser()
    if words.command == "add" and words.create and given.is_dir():
        return master_directory(given)
    return existing_master_directory(given)


async def _run_audited(store: Store, words: argparse.Namespace) -> None:
    work = _limits(store, words) if words.command == "limits" else _act(Users(store), words)
    action = ACTIONS.get(words.command)
    if action is None or (words.command == "limits" and not words.changes):
        return await work
    audit = Audit(store)
    thing = "/".join([words.user, *filter(None, [getattr(words, "key", ""), getattr(words, "label", "")])])
    try:
        with audit.auditing(action, words.user, thing, Origin("offline")) as audited:
            audited.who = Principal(f"@{getpass.getuser()}", "admin")  # a user of this machine, not of the platform
            await work
    finally:
        await audit.flush()


async def _limits(store: Store, words: argparse.Namespace) -> None:
    limits = UserLimits(store)
    await limits.open()
    if words.user not in await Users(store).names():
        raise NotFound(f"there is no user {words.user}", field="userID")
    added = [change.removeprefix(ADD_IMAGE) for change in words.changes if change.startswith(ADD_IMAGE)]
    changes = parse(change for change in words.changes if not change.startswith(ADD_IMAGE))
    if added:
        present = changes.get("images", limits.own(words.user).get("images")) or []
        changes["images"] = list(dict.fromkeys([*present, *added]))
    if changes:
        await limits.change(words.user, changes)
    own, whole = limits.own(words.user), msgspec.structs.asdict(limits.of(words.user))
    if words.json:
        print(msgspec.json.encode(whole).decode())
        return
    for name, value in whole.items():
        text = ", ".join(value) if isinstance(value, list) else NO_LIMIT if value is None else str(value)
        print(f"{name:18} {text:16} {'own' if name in own else ''}".rstrip())


async def _act(users: Users, words: argparse.Namespace) -> None:
    match words.command:
        case "add":
            password = _password()
            check_password(password, words.user)
            await users.add(words.user, password, words.role)
        case "passwd":
            await users.get(words.user)
            password = _password()
            check_password(password, words.user)
            await users.change_password(words.user, password)
        case "remove":
            await users.remove(words.user)
        case "list":
            names = await users.names()
            print(msgspec.json.encode(names).decode() if words.json else "\n".join(names))
        case "key-add":
            expires = time.time() + words.days * DAY if words.days else None
            secret, _ = await users.keys.add(
                words.user, words.role, words.label, expires, Scopes(words.robot, words.environment)
            )
            print(secret)
        case "key-list":
            keys = await users.keys.of(words.user)
            if words.json:
                print(msgspec.json.encode(keys).decode())
            else:
                for key in keys:
                    until = time.strftime("%Y-%m-%d", time.gmtime(key.expires)) if key.expires else "never expires"
                    print(f"{key.id}  {key.role:8}  {until:13}  {key.label}")
        case "key-revoke":
            await users.keys.revoke(words.user, words.key)


def main() -> int:
    """Run the command line and return the exit status."""
    words = parser().parse_args()
    try:
        asyncio.run(run(words))
    except RceError as error:
        print(f"rce user: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
