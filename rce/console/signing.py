"""`login`, `logout`, `context`, `whoami`; the console itself: `console`, `watch`, `help`, `completion`."""

from __future__ import annotations

import argparse
import getpass
import os
import socket
import sys
import time
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from rce import contexts, views
from rce.api import Api
from rce.console import show
from rce.console.command import JSON, Command, argument
from rce.console.session import Session
from rce.contexts import Context
from rce.errors import NotFound, RceError, Unauthorized, Unavailable

DAY = 86_400.0
DAYS = 30.0  # for which one is signed in
SHELLS = ("bash", "zsh", "fish")


class Row(NamedTuple):
    """A context in the list."""

    name: str
    context: Context
    current: bool


CONTEXTS: show.Columns[Row] = {
    "": lambda each: "*" if each.current else " ",
    "context": lambda each: each.name,
    "user": lambda each: each.context.user,
    "url": lambda each: each.context.url,
    "until": lambda each: show.when(each.context.expires, "never expires"),
}


RIGHTS: show.Columns[tuple[str, str]] = {
    "operation": lambda each: each[0],
    "on": lambda each: each[1],
}


def login(session: Session, words: argparse.Namespace) -> None:
    """The password is asked for, or read from RCE_PASSWORD or standard input; what is kept is a key made with it."""
    user = words.user or _ask("User: ")
    password = os.environ.get("RCE_PASSWORD") or secret(f"Password of {user}: ")
    label = f"console at {socket.gethostname()}"
    wanted = views.NewKey(label=label, expires=time.time() + words.days * DAY)
    made = Api(words.url, user=user, password=password).post(views.MadeKey, "keys", body=wanted)
    known = contexts.load()
    name = words.name or _free_name(known, words.url, user)
    known.contexts[name] = Context(words.url, user, made.secret, made.key.id, made.key.expires)
    known.current = name
    contexts.save(known)
    session.forget()
    print(f"signed in at {words.url} as {user} ({made.key.role}); this is the context {name}")


def _free_name(known: contexts.Contexts, url: str, user: str) -> str:
    """The host's name; that of the same platform and user, if there is one."""
    host = url.partition("://")[2].strip("/")
    same = (name for name, each in known.contexts.items() if (each.url, each.user) == (url, user))
    return next(same, host if host not in known.contexts else f"{user}@{host}")


def logout(session: Session, words: argparse.Namespace) -> None:
    known = contexts.load()
    name = words.name or known.current
    if not name:
        raise Unauthorized("you are not signed in")
    _revoke(known.named(name))
    _forget(known, name)
    session.forget()
    print(f"signed out: context {name} is gone")


def _revoke(context: Context) -> None:
    try:
        Api(context.url, key=context.key).delete("keys", context.id)
    except (NotFound, Unauthorized):
        return  # it is void already
    except Unavailable as error:
        print(f"the key {context.id} could not be revoked: {error}", file=sys.stderr)


def _forget(known: contexts.Contexts, name: str) -> None:
    known.named(name)
    del known.contexts[name]
    if known.current == name:
        known.current = next(iter(known.contexts), "")
    contexts.save(known)


def context_list(session: Session, words: argparse.Namespace) -> None:
    known = contexts.load()
    if words.json:
        shown = {
            name: {"url": each.url, "user": each.user, "expires": each.expires} for name, each in known.contexts.items()
        }
        show.one({"current": known.current, "contexts": shown}, as_json=True)
        return
    show.rows((Row(name, each, name == known.current) for name, each in known.contexts.items()), CONTEXTS)


def context_use(session: Session, words: argparse.Namespace) -> None:
    known = contexts.load()
    known.named(words.name)
    known.current = words.name
    contexts.save(known)
    session.use(words.name)


def context_remove(session: Session, words: argparse.Namespace) -> None:
    _forget(contexts.load(), words.name)
    session.forget()


def whoami(session: Session, words: argparse.Namespace) -> None:
    me = session.api.get(views.Whoami, "whoami")
    if words.rights:
        show.rows(me.rights.items(), RIGHTS)
    else:
        show.one(me if words.json else replace(me, rights={}), words.json)


def console(session: Session, words: argparse.Namespace) -> int:
    from rce.console.script import run_script

    if words.file:
        with Path(words.file).open() as lines:
            return run_script(lines, session, words.file, words.keep_going)
    if not sys.stdin.isatty():
        return run_script(sys.stdin, session, keep_going=words.keep_going)
    from rce.console.interactive import converse

    return converse(session)


def watch(session: Session, words: argparse.Namespace) -> int:
    from rce.console.run import STOPPED, run

    while True:
        if sys.stdout.isatty():
            print("\x1b[H\x1b[2J", end="")
        print(f"every {words.seconds:g} s: {' '.join(words.command)}    {show.when(time.time())}\n", flush=True)
        status = run(words.command, session)
        if status:
            return 0 if status == STOPPED else status
        time.sleep(words.seconds)


def help_(session: Session, words: argparse.Namespace) -> int:
    from rce.console import table
    from rce.console.run import run

    if words.command:
        return run([*words.command, "--help"], session)
    print(table.overview())
    return 0


def completion(session: Session, words: argparse.Namespace) -> None:
    from rce.console.shells import SCRIPTS

    print(SCRIPTS[words.shell], end="")


def _ask(prompt: str) -> str:
    print(prompt, end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline().strip()
    if not answer:
        raise RceError("nothing was said")
    return answer


def secret(prompt: str, again: bool = False) -> str:
    """A password: asked for at a terminal, else a line of standard input."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    first = getpass.getpass(prompt)
    if again and getpass.getpass("Again: ") != first:
        raise RceError("the two passwords differ")
    return first


NAME = argument("name", live="context", metavar="CONTEXT")

COMMANDS = (
    Command(
        "login",
        "Sign in to a platform: makes an API key and keeps it where only you can read it.",
        login,
        (
            argument("url", metavar="URL", help="its entry, as http://host:9000/"),
            argument("--user", default="", help="(default: asked for)"),
            argument("--context", dest="name", default="", metavar="NAME", help="what to call it (default: its host)"),
            argument("--days", type=float, default=DAYS, help="for which the key is good (default: %(default)g)"),
        ),
        ("login https://robots.example.org:9000/", "login http://127.0.0.1:9000/ --user admin --context home"),
        remote=False,
    ),
    Command(
        "logout",
        "Sign out: revokes the key and forgets the context.",
        logout,
        (
            argument(
                "name", live="context", nargs="?", default="", metavar="CONTEXT", help="(default: the current one)"
            ),
        ),
        ("logout", "logout home"),
        remote=False,
    ),
    Command("context list", "List the platforms that you have signed in to.", context_list, (JSON,), remote=False),
    Command(
        "context use", "Let commands go to this platform.", context_use, (NAME,), ("context use home",), remote=False
    ),
    Command("context remove", "Forget a platform, without revoking its key.", context_remove, (NAME,), remote=False),
    Command(
        "whoami",
        "Show who you are at the platform.",
        whoami,
        (
            argument(
                "--rights", action="store_true", help="what you may do, to what is yours (own) or everybody's (all)"
            ),
            JSON,
        ),
        ("whoami", "whoami --rights"),
    ),
    Command(
        "console",
        "Commands one after the other: typed, or from a script.",
        console,
        (
            argument("file", nargs="?", default="", metavar="FILE", help="(default: standard input)"),
            argument("--keep-going", action="store_true", help="do not stop at the first line that fails"),
        ),
        ("console", "console < setup.rce", "console --keep-going checks.rce"),
    ),
    Command(
        "watch",
        "Repeat a command until Ctrl-C.",
        watch,
        (
            argument(
                "-n", "--seconds", type=float, default=2.0, metavar="SECONDS", help="between (default: %(default)g)"
            ),
            argument("command", live="words", nargs="...", metavar="COMMAND"),
        ),
        ("watch robot list", "watch -n 0.5 interface list brain"),
    ),
    Command(
        "help",
        "List the commands, or tell about one.",
        help_,
        (argument("command", live="words", nargs="...", metavar="COMMAND"),),
        ("help", "help env create"),
        remote=False,
    ),
    Command(
        "completion",
        "Print the completion script of a shell.",
        completion,
        (argument("shell", choices=SHELLS),),
        ("completion bash > ~/.local/share/bash-completion/completions/rce",),
        remote=False,
    ),
)
