"""`user`, `key`, `audit`: accounts with their limits, API keys, and the audit log."""

from __future__ import annotations

import argparse
import os
import sys
import time
from datetime import datetime
from typing import Any, get_args

from rce.api import views
from rce.api.client import ApiClient
from rce.api.roles import Scopes, UserRole
from rce.cli import output
from rce.cli.arguments import JSON, OF_USER, OF_USER_OR_ALL, argument
from rce.cli.command import Command
from rce.cli.commands.login import DAY, read_password
from rce.cli.session import ConsoleSession, user_query
from rce.errors import InvalidRequest

USER = argument("name", completion="user", metavar="USER")
OPTIONAL_USER = argument("name", completion="user", nargs="?", default="", metavar="USER", help="(default: you)")
KEY = argument("key", completion="key", metavar="KEY", help="its id")
ROLES = get_args(UserRole)

USERS: output.Columns[views.UserView] = {
    "user": lambda each: each.name,
    "role": lambda each: each.role,
    "since": lambda each: output.local_time(each.created),
}
KEYS: output.Columns[views.KeyView] = {
    "key": lambda each: each.id,
    "user": lambda each: each.user,
    "role": lambda each: each.role,
    "label": lambda each: each.label,
    "expires": lambda each: output.local_time(each.expires, "never"),
    "last used": lambda each: output.local_time(each.used, "never"),
    "robot": lambda each: each.scopes.robot,
    "environments": lambda each: each.scopes.environments,
}
AUDIT: output.Columns[views.AuditView] = {
    "time": lambda each: output.local_time(each.time),
    "user": lambda each: each.user,
    "action": lambda each: each.action,
    "object": lambda each: each.object,
    "result": lambda each: each.result,
    "from": lambda each: each.origin,
}


def _user_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(session.api.items(views.UserView, "users"), USERS, args.json)


def _user_show(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_record(session.api.get(views.UserView, "users", args.name or session.user), args.json)


def _user_add(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.access  # noqa: B018  # raises, before asking for a password, if there are no credentials
    password = args.password or read_password(f"Password for {args.name}: ", repeat=True)
    session.api.post(views.UserView, "users", body=views.NewUser(args.name, password, args.role))


def _user_remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.delete("users", args.name)


def _user_role(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.patch(views.UserView, "users", args.name, body=views.UserChanges(args.role))


def _user_passwd(session: ConsoleSession, args: argparse.Namespace) -> None:
    name = args.name or session.user
    old = args.old or (read_password("Present password: ") if name == session.user else "")
    new = args.new or read_password("New password: ", repeat=True)
    session.api.put("users", name, "password", body=views.NewPassword(new, old))


def _user_limits(session: ConsoleSession, args: argparse.Namespace) -> None:
    path = ("users", args.name or session.user, "limits")
    if args.changes:
        present = session.api.get(dict[str, Any], *path)
        session.api.patch(Any, *path, body=dict(_parse_change(each, present) for each in args.changes))
    limits = session.api.get(dict[str, Any], *path)
    output.print_record(
        limits if args.json else {name: _limit_text(value) for name, value in limits.items()}, args.json
    )


def _limit_text(value: Any) -> Any:
    """Return a limit as `print_record` shows it, which leaves out what is empty."""
    return "-" if value is None else "none" if value == [] else value


def _parse_change(text: str, present: dict[str, Any]) -> tuple[str, Any]:
    """Parse a change of a limit: `key=value`, `key=-` for none, `key=` for the default, `key+=value` for a list.

    Raises:
        InvalidRequest: The text has another form.
    """
    name, equals, value = text.partition("=")
    if not equals:
        raise InvalidRequest(f"{text!r}: write key=value", field=name)
    if name.endswith("+"):
        name = name.removesuffix("+")
        return name, [*dict.fromkeys([*present.get(name, []), value])]
    return name, value


def _user_usage(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_record(session.api.get(views.UsageView, "users", args.name or session.user, "usage"), args.json)


def _key_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    output.print_table(session.api.items(views.KeyView, "keys", user=user_query(args.of)), KEYS, args.json)


def _key_create(session: ConsoleSession, args: argparse.Namespace) -> None:
    expires = time.time() + args.days * DAY if args.days else None
    role: Any = args.role or ("operator" if args.metrics else "robot")
    body = views.NewKey(role, args.label, expires, Scopes(args.robot, args.environment, args.metrics))
    made = _api_by_password(session).post(views.CreatedKey, "keys", body=body, user=args.of)
    print(output.to_json(made) if args.json else made.secret)


def _key_rotate(session: ConsoleSession, args: argparse.Namespace) -> None:
    print(_api_by_password(session).post(views.CreatedKey, "keys", args.key, "rotate", user=args.of).secret)


def _api_by_password(session: ConsoleSession) -> ApiClient:
    """Return a client with the user's password, since what is made with a key ends with that key.

    The password comes from RCE_PASSWORD or a terminal; without one it is the client of the session.
    """
    if session.access.password is not None:
        return session.api
    password = os.environ.get("RCE_PASSWORD") or (
        read_password(f"Password of {session.user}: ") if sys.stdin.isatty() else ""
    )
    return ApiClient(session.access.url, user=session.user, password=password) if password else session.api


def _key_revoke(session: ConsoleSession, args: argparse.Namespace) -> None:
    session.api.delete("keys", args.key, user=args.of)


def _audit(session: ConsoleSession, args: argparse.Namespace) -> None:
    query = {name: getattr(args, name) for name in ("action", "object", "result")}
    query |= {"user": args.by, "since": _parse_time(args.since), "until": _parse_time(args.until)}
    output.print_table(session.api.items(views.AuditView, "audit", limit=args.lines, **query), AUDIT, args.json)


def _parse_time(text: str) -> float | None:
    """Parse a time in this machine's time zone, or seconds since 1970; return the latter, or None for no text.

    Raises:
        InvalidRequest: The text is neither.
    """
    if not text:
        return None
    try:
        return float(text) if text.replace(".", "").isdigit() else datetime.fromisoformat(text).timestamp()
    except ValueError:
        raise InvalidRequest(f"{text!r} is not a time: write 2030-01-31T08:00, or seconds since 1970") from None


COMMANDS = (
    Command("user list", "List the users.", _user_list, (JSON,), ("user list",)),
    Command("user show", "Show a user.", _user_show, (OPTIONAL_USER, JSON), ("user show ada",)),
    Command(
        "user add",
        "Add a user, with the password from a prompt or standard input.",
        _user_add,
        (
            argument("name", metavar="USER"),
            argument("--role", choices=ROLES, default="user", help="(default: %(default)s)"),
            argument("--password", default="", help="safer: at the prompt"),
        ),
        ("user add ada", "user add olga --role operator"),
    ),
    Command(
        "user remove", "Remove a user and all that belongs to the user.", _user_remove, (USER,), ("user remove ada",)
    ),
    Command(
        "user role",
        "Change the role of a user.",
        _user_role,
        (USER, argument("role", choices=ROLES)),
        ("user role ada operator",),
    ),
    Command(
        "user passwd",
        "Change your password, or another user's if you have the permission.",
        _user_passwd,
        (
            OPTIONAL_USER,
            argument("--new", default="", metavar="PASSWORD", help="safer: at the prompt"),
            argument("--old", default="", metavar="PASSWORD", help="safer: at the prompt"),
        ),
        ("user passwd", "user passwd ada"),
    ),
    Command(
        "user limits",
        "Show or change the limits of a user; `-` is no limit, 0 is zero.",
        _user_limits,
        (
            OPTIONAL_USER,
            argument(
                "changes",
                nargs="*",
                metavar="KEY=VALUE",
                help="as memory=2GiB; `memory=-` is no limit; `memory=` resets; images+=NAME appends",
            ),
            JSON,
        ),
        ("user limits ada", "user limits ada environments=4 total_memory=8GiB images=rce/base,mine/*"),
    ),
    Command(
        "user usage",
        "Show what a user has used of the limits.",
        _user_usage,
        (OPTIONAL_USER, JSON),
        ("user usage ada",),
    ),
    Command("key list", "List API keys.", _key_list, (OF_USER_OR_ALL, JSON), ("key list", "key list --of ada --json")),
    Command(
        "key create",
        "Create an API key and print it; it is not shown again. Asks for your password (or takes RCE_PASSWORD); with "
        "an empty one, the key ends with the key that you are signed in with.",
        _key_create,
        (
            argument("--role", choices=ROLES, help="its permissions (default: robot)", default=""),
            argument("--label", default="", help="a note for the list of keys"),
            argument("--days", type=float, default=0, metavar="N", help="until it expires (default: never)"),
            argument("--robot", completion="robot", default="", metavar="ROBOT", help="restrict to this robotID"),
            argument(
                "--environment",
                completion="environment",
                action="append",
                default=[],
                metavar="ENV",
                help="restrict to this environment; may be given several times",
            ),
            argument("--metrics", action="store_true", help="for reading metrics only; needs an operator"),
            OF_USER,
            JSON,
        ),
        (
            "key create --label r2d2 --robot r2d2 --days 90",
            "key create --of ada --role user",
            "key create --metrics --label prometheus",
        ),
    ),
    Command(
        "key rotate",
        "Replace the secret of a key and print the new one; the old one becomes invalid. Asks for your password (or "
        "takes RCE_PASSWORD), except for keys that were made with the key that you are signed in with.",
        _key_rotate,
        (KEY, OF_USER),
        ("key rotate 6f…",),
    ),
    Command(
        "key revoke",
        "Revoke a key and close the connections made with it.",
        _key_revoke,
        (KEY, OF_USER),
        ("key revoke 6f…",),
    ),
    Command(
        "audit",
        "List actions from the audit log, newest first.",
        _audit,
        (
            argument("--by", completion="user", default="", metavar="USER"),
            argument("--action", default="", help="as key.create"),
            argument("--object", default="", help="as ada/brain"),
            argument("--result", default="", help="ok, or the code of an error"),
            argument("--since", default="", metavar="TIME", help="as 2030-01-31T08:00, or seconds since 1970"),
            argument("--until", default="", metavar="TIME"),
            argument(
                "-n", "--lines", type=int, default=100, metavar="N", help="at most N lines (default: %(default)s)"
            ),
            JSON,
        ),
        ("audit --by ada --action environment.create", "audit --result unauthorized -n 20"),
    ),
)
