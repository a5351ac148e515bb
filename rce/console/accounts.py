"""`user`, `key`, `audit`: who may use the platform, with what, and what they did."""

from __future__ import annotations

import argparse
import time
from datetime import datetime
from typing import Any, get_args

from rce import views
from rce.console import show
from rce.console.command import JSON, LISTED, OF, Command, argument
from rce.console.session import Session, whose
from rce.console.signing import DAY, secret
from rce.errors import InvalidRequest
from rce.roles import Scopes, UserRole

USER = argument("name", live="user", metavar="USER")
MAYBE = argument("name", live="user", nargs="?", default="", metavar="USER", help="(default: you)")
KEY = argument("key", live="key", metavar="KEY", help="its id")
ROLES = get_args(UserRole)

USERS: show.Columns[views.UserView] = {
    "user": lambda each: each.name,
    "role": lambda each: each.role,
    "since": lambda each: show.when(each.created),
}
KEYS: show.Columns[views.KeyView] = {
    "key": lambda each: each.id,
    "user": lambda each: each.user,
    "role": lambda each: each.role,
    "label": lambda each: each.label,
    "expires": lambda each: show.when(each.expires, "never"),
    "last used": lambda each: show.when(each.used, "never"),
    "robot": lambda each: each.scopes.robot,
    "environments": lambda each: each.scopes.environments,
}
AUDIT: show.Columns[views.AuditView] = {
    "time": lambda each: show.when(each.time),
    "user": lambda each: each.user,
    "action": lambda each: each.action,
    "object": lambda each: each.object,
    "result": lambda each: each.result,
    "from": lambda each: each.origin,
}


def user_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(session.api.items(views.UserView, "users"), USERS, words.json)


def user_show(session: Session, words: argparse.Namespace) -> None:
    show.one(session.api.get(views.UserView, "users", words.name or session.user), words.json)


def user_add(session: Session, words: argparse.Namespace) -> None:
    session.access  # noqa: B018  # who is not signed in need not think of a password
    password = words.password or secret(f"Password for {words.name}: ", again=True)
    session.api.post(views.UserView, "users", body=views.NewUser(words.name, password, words.role))


def user_remove(session: Session, words: argparse.Namespace) -> None:
    session.api.delete("users", words.name)


def user_role(session: Session, words: argparse.Namespace) -> None:
    session.api.patch(views.UserView, "users", words.name, body=views.UserChanges(words.role))


def user_passwd(session: Session, words: argparse.Namespace) -> None:
    name = words.name or session.user
    old = words.old or (secret("Present password: ") if name == session.user else "")
    new = words.new or secret("New password: ", again=True)
    session.api.put("users", name, "password", body=views.NewPassword(new, old))


def user_limits(session: Session, words: argparse.Namespace) -> None:
    path = ("users", words.name or session.user, "limits")
    if words.changes:
        present = session.api.get(dict[str, Any], *path)
        session.api.patch(Any, *path, body=dict(_change(each, present) for each in words.changes))
    limits = session.api.get(dict[str, Any], *path)
    show.one(limits if words.json else {name: value or "-" for name, value in limits.items()}, words.json)


def _change(text: str, present: dict[str, Any]) -> tuple[str, Any]:
    """`key=value`, `key=` to undo, `key+=value` for one more in a list. InvalidRequest."""
    name, equals, value = text.partition("=")
    if not equals:
        raise InvalidRequest(f"{text!r}: write key=value", field=name)
    if name.endswith("+"):
        name = name.removesuffix("+")
        return name, [*dict.fromkeys([*present.get(name, []), value])]
    return name, value or None


def user_usage(session: Session, words: argparse.Namespace) -> None:
    show.one(session.api.get(views.UsageView, "users", words.name or session.user, "usage"), words.json)


def key_list(session: Session, words: argparse.Namespace) -> None:
    show.rows(session.api.items(views.KeyView, "keys", user=whose(words.of)), KEYS, words.json)


def key_create(session: Session, words: argparse.Namespace) -> None:
    expires = time.time() + words.days * DAY if words.days else None
    body = views.NewKey(words.role, words.label, expires, Scopes(words.robot, words.environment, words.metrics))
    made = session.api.post(views.MadeKey, "keys", body=body, user=words.of)
    print(show.text(made) if words.json else made.secret)


def key_rotate(session: Session, words: argparse.Namespace) -> None:
    print(session.api.post(views.MadeKey, "keys", words.key, "rotate", user=words.of).secret)


def key_revoke(session: Session, words: argparse.Namespace) -> None:
    session.api.delete("keys", words.key, user=words.of)


def audit(session: Session, words: argparse.Namespace) -> None:
    query = {name: getattr(words, name) for name in ("action", "object", "result")}
    query |= {"user": words.by, "since": _seconds(words.since), "until": _seconds(words.until)}
    show.rows(session.api.items(views.AuditView, "audit", limit=words.lines, **query), AUDIT, words.json)


def _seconds(text: str) -> float | None:
    """A time by this machine's clock, or seconds since 1970. InvalidRequest."""
    if not text:
        return None
    try:
        return float(text) if text.replace(".", "").isdigit() else datetime.fromisoformat(text).timestamp()
    except ValueError:
        raise InvalidRequest(f"{text!r} is no time: write 2030-01-31T08:00, or seconds since 1970") from None


COMMANDS = (
    Command("user list", "List the users.", user_list, (JSON,), ("user list",)),
    Command("user show", "Show a user.", user_show, (MAYBE, JSON), ("user show ada",)),
    Command(
        "user add",
        "Add a user; the password is asked for, or read from standard input.",
        user_add,
        (
            argument("name", metavar="USER"),
            argument("--role", choices=ROLES, default="user", help="(default: %(default)s)"),
            argument("--password", default="", help="better: when asked"),
        ),
        ("user add ada", "user add olga --role operator"),
    ),
    Command("user remove", "Remove a user with all that is theirs.", user_remove, (USER,), ("user remove ada",)),
    Command(
        "user role",
        "Give a user another role.",
        user_role,
        (USER, argument("role", choices=ROLES)),
        ("user role ada operator",),
    ),
    Command(
        "user passwd",
        "Change a password: one's own, or for those who may another user's.",
        user_passwd,
        (
            MAYBE,
            argument("--new", default="", metavar="PASSWORD", help="better: when asked"),
            argument("--old", default="", metavar="PASSWORD", help="better: when asked"),
        ),
        ("user passwd", "user passwd ada"),
    ),
    Command(
        "user limits",
        "Show or change what a user may have; `-` is no limit.",
        user_limits,
        (
            MAYBE,
            argument("changes", nargs="*", metavar="KEY=VALUE", help="as memory=2GiB; `memory=` undoes; images+=NAME"),
            JSON,
        ),
        ("user limits ada", "user limits ada environments=4 total_memory=8GiB images=rce/base,mine/*"),
    ),
    Command(
        "user usage", "Show what a user has of what they may have.", user_usage, (MAYBE, JSON), ("user usage ada",)
    ),
    Command("key list", "List API keys.", key_list, (LISTED, JSON), ("key list", "key list --of ada --json")),
    Command(
        "key create",
        "Make an API key and print it; it is shown this once.",
        key_create,
        (
            argument("--role", choices=ROLES, help="what it may do (default: as a robot)", default="robot"),
            argument("--label", default="", help="for people"),
            argument("--days", type=float, default=0, metavar="N", help="until it expires (default: never)"),
            argument("--robot", live="robot", default="", metavar="ROBOT", help="only as this robotID"),
            argument(
                "--environment",
                live="environment",
                action="append",
                default=[],
                metavar="ENV",
                help="only with this environment; may be given again",
            ),
            argument("--metrics", action="store_true", help="only to read metrics"),
            OF,
            JSON,
        ),
        ("key create --label r2d2 --robot r2d2 --days 90", "key create --of ada --role user"),
    ),
    Command(
        "key rotate",
        "Give a key a new secret and print it; the old one is void.",
        key_rotate,
        (KEY, OF),
        ("key rotate 6f…",),
    ),
    Command(
        "key revoke", "Revoke a key; what is connected with it is cut off.", key_revoke, (KEY, OF), ("key revoke 6f…",)
    ),
    Command(
        "audit",
        "Who did what to what, from where, with what result; the newest first.",
        audit,
        (
            argument("--by", live="user", default="", metavar="USER"),
            argument("--action", default="", help="as key.create"),
            argument("--object", default="", help="as ada/brain"),
            argument("--result", default="", help="ok, or the code of an error"),
            argument("--since", default="", metavar="TIME", help="as 2030-01-31T08:00, or seconds since 1970"),
            argument("--until", default="", metavar="TIME"),
            argument("-n", "--lines", type=int, default=100, metavar="N", help="N at most (default: %(default)s)"),
            JSON,
        ),
        ("audit --by ada --action environment.create", "audit --result unauthorized -n 20"),
    ),
)
