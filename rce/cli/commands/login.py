"""`login`, `logout`, `context`, `whoami`, and the console's own commands: `console`, `watch`, `help`, `completion`."""

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

from rce.api import views
from rce.api.client import ApiClient
from rce.api.http import EntryClient
from rce.cli import contexts, output
from rce.cli.arguments import JSON, argument
from rce.cli.command import Command
from rce.cli.contexts import Context
from rce.cli.session import ConsoleSession
from rce.errors import NotFound, RceError, Unauthorized, Unavailable

DAY = 86_400.0
KEY_DAYS = 30.0  # until a login expires
SHELLS = ("bash", "zsh", "fish")


class ContextRow(NamedTuple):
    """Row of the list of contexts."""

    name: str
    context: Context
    current: bool


CONTEXTS: output.Columns[ContextRow] = {
    "": lambda each: "*" if each.current else " ",
    "context": lambda each: each.name,
    "user": lambda each: each.context.user,
    "url": lambda each: each.context.url,
    "until": lambda each: output.local_time(each.context.expires, "never expires"),
}


RIGHTS: output.Columns[tuple[str, str]] = {
    "operation": lambda each: each[0],
    "on": lambda each: each[1],
}


def _login(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Create an API key with the user's password and keep the key, not the password.

    The password comes from RCE_PASSWORD, a prompt, or standard input.
    """
    EntryClient(args.url, {}).open("GET", "healthz").close()  # before anything is asked
    user = args.user or _ask("User: ")
    password = os.environ.get("RCE_PASSWORD") or read_password(f"Password of {user}: ")
    label = f"console at {socket.gethostname()}"
    wanted = views.NewKey(label=label, expires=time.time() + args.days * DAY)
    made = ApiClient(args.url, user=user, password=password).post(views.CreatedKey, "keys", body=wanted)
    known = contexts.load()
    name = args.name or _context_name(known, args.url, user)
    known.contexts[name] = Context(args.url, user, made.secret, made.key.id, made.key.expires)
    known.current = name
    contexts.save(known)
    session.forget_access()
    print(f"signed in at {args.url} as {user} ({made.key.role}); this is the context {name}")


def _context_name(known: contexts.Contexts, url: str, user: str) -> str:
    """Return the name of the context of this platform and user, or a new one made of the host's name."""
    host = url.partition("://")[2].strip("/")
    same = (name for name, each in known.contexts.items() if (each.url, each.user) == (url, user))
    return next(same, host if host not in known.contexts else f"{user}@{host}")


def _logout(session: ConsoleSession, args: argparse.Namespace) -> None:
    known = contexts.load()
    name = args.name or known.current
    if not name:
        raise Unauthorized(f"you are not signed in{_hint(known)}")
    _revoke(known.named(name))
    _remove(known, name)
    session.forget_access()
    print(f"signed out: context {name} is removed{_hint(known)}")


def _revoke(context: Context) -> None:
    try:
        ApiClient(context.url, key=context.key).delete("keys", context.id)
    except (NotFound, Unauthorized):
        return  # the key is invalid already
    except Unavailable as error:
        print(f"the key {context.id} could not be revoked: {error}", file=sys.stderr)


def _remove(known: contexts.Contexts, name: str) -> None:
    known.named(name)
    del known.contexts[name]
    if known.current == name:
        known.current = ""
    contexts.save(known)


def _hint(known: contexts.Contexts) -> str:
    """Return how to make a context current, if there are some and none is."""
    others = ", ".join(known.contexts)
    return (
        f"; no context is current: choose one with `rce context use NAME` ({others})"
        if others and not known.current
        else ""
    )


def _context_list(session: ConsoleSession, args: argparse.Namespace) -> None:
    known = contexts.load()
    if args.json:
        listed = {
            name: {"url": each.url, "user": each.user, "expires": each.expires} for name, each in known.contexts.items()
        }
        output.print_record({"current": known.current, "contexts": listed}, as_json=True)
        return
    output.print_table(
        (ContextRow(name, each, name == known.current) for name, each in known.contexts.items()), CONTEXTS
    )


def _context_use(session: ConsoleSession, args: argparse.Namespace) -> None:
    known = contexts.load()
    known.named(args.name)
    known.current = args.name
    contexts.save(known)
    session.use_context(args.name)


def _context_remove(session: ConsoleSession, args: argparse.Namespace) -> None:
    _remove(contexts.load(), args.name)
    session.forget_access()


def _whoami(session: ConsoleSession, args: argparse.Namespace) -> None:
    me = session.api.get(views.Whoami, "whoami")
    if args.rights:
        output.print_table(me.rights.items(), RIGHTS)
    else:
        output.print_record(me if args.json else replace(me, rights={}), args.json)


def _console(session: ConsoleSession, args: argparse.Namespace) -> int:
    from rce.cli.script import run_script

    session.in_console = True
    if args.file:
        with Path(args.file).open() as lines:
            return run_script(lines, session, args.file, args.keep_going)
    if not sys.stdin.isatty():
        return run_script(sys.stdin, session, keep_going=args.keep_going)
    from rce.cli.interactive import run_console

    return run_console(session)


def _watch(session: ConsoleSession, args: argparse.Namespace) -> int:
    from rce.cli.execute import INTERRUPTED, run

    while True:
        if sys.stdout.isatty():
            print("\x1b[H\x1b[2J", end="")
        print(f"every {args.seconds:g} s: {' '.join(args.command)}    {output.local_time(time.time())}\n", flush=True)
        status = run(args.command, session)
        if status:
            return 0 if status == INTERRUPTED else status
        time.sleep(args.seconds)


def _help(session: ConsoleSession, args: argparse.Namespace) -> int:
    from rce.cli import table
    from rce.cli.execute import print_help

    if args.command:
        return print_help(args.command, session.in_console)
    print(table.console_overview() if session.in_console else table.overview())
    return 0


def _completion(session: ConsoleSession, args: argparse.Namespace) -> None:
    from rce.cli.completion_scripts import SCRIPTS

    print(SCRIPTS[args.shell], end="")


def _ask(prompt: str) -> str:
    print(prompt, end="", file=sys.stderr, flush=True)
    answer = sys.stdin.readline().strip()
    if not answer:
        raise RceError(f"no answer to {prompt.strip()!r}")
    return answer


def read_password(prompt: str, repeat: bool = False) -> str:
    """Prompt for a password on a terminal, else read a line of standard input.

    Raises:
        RceError: The repetition differs, or there was no answer.
    """
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    try:
        first = getpass.getpass(prompt)
        if repeat and getpass.getpass("Again: ") != first:
            raise RceError("the passwords differ")
    except EOFError:  # Ctrl-D
        print(file=sys.stderr)
        raise RceError(f"no answer to {prompt.strip()!r}") from None
    return first


NAME = argument("name", completion="context", metavar="CONTEXT")

COMMANDS = (
    Command(
        "login",
        "Sign in to a platform: creates an API key and keeps it in a file that only you can read.",
        _login,
        (
            argument("url", metavar="URL", help="its entry, as http://host:9000/"),
            argument("--user", default="", help="(default: prompt)"),
            argument(
                "--context", dest="name", default="", metavar="NAME", help="name of the context (default: the host)"
            ),
            argument("--days", type=float, default=KEY_DAYS, help="until the key expires (default: %(default)g)"),
        ),
        ("login https://robots.example.org:9000/", "login http://127.0.0.1:9000/ --user admin --context home"),
        platform=None,
    ),
    Command(
        "logout",
        "Sign out: revokes the key and removes the context.",
        _logout,
        (
            argument(
                "name",
                completion="context",
                nargs="?",
                default="",
                metavar="CONTEXT",
                help="(default: the current one)",
            ),
        ),
        ("logout", "logout home"),
        platform=None,
    ),
    Command("context list", "List the platforms that you have signed in to.", _context_list, (JSON,), platform=None),
    Command(
        "context use",
        "Make this platform the current one.",
        _context_use,
        (NAME,),
        ("context use home",),
        platform=None,
    ),
    Command("context remove", "Remove a context without revoking its key.", _context_remove, (NAME,), platform=None),
    Command(
        "whoami",
        "Show your user and role at the platform.",
        _whoami,
        (
            argument(
                "--rights",
                action="store_true",
                help="show your permissions, on your own objects (own) or on all users' (all)",
            ),
            JSON,
        ),
        ("whoami", "whoami --rights"),
    ),
    Command(
        "console",
        "Run commands typed at a prompt, or those of a script.",
        _console,
        (
            argument("file", nargs="?", default="", metavar="FILE", help="(default: standard input)"),
            argument("--keep-going", action="store_true", help="do not stop at the first line that fails"),
        ),
        ("console", "console < setup.rce", "console --keep-going checks.rce"),
    ),
    Command(
        "watch",
        "Repeat a command until Ctrl-C.",
        _watch,
        (
            argument(
                "-n",
                "--seconds",
                type=float,
                default=2.0,
                metavar="SECONDS",
                help="pause between runs (default: %(default)g)",
            ),
            argument("command", completion="console command", nargs="...", metavar="COMMAND"),
        ),
        ("watch robot list", "watch -n 0.5 interface list brain"),
    ),
    Command(
        "help",
        "List the commands, or explain one.",
        _help,
        (argument("command", completion="command", nargs="...", metavar="COMMAND"),),
        ("help", "help env create"),
        platform=None,
    ),
    Command(
        "completion",
        "Print the completion script of a shell.",
        _completion,
        (argument("shell", choices=SHELLS),),
        ("completion bash > ~/.local/share/bash-completion/completions/rce",),
        platform=None,
    ),
)
