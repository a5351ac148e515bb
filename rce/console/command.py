"""What a command is: its name, arguments, help with examples, and the function that carries it out."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, NoReturn

from rce.errors import InvalidRequest

if TYPE_CHECKING:  # the session shows what commands find
    from rce.console.session import Session

Live = Literal[
    "",
    "context",
    "endpoint",
    "environment",
    "group",
    "interface",
    "key",
    "machine",
    "robot",
    "service",
    "topic",
    "type",
    "user",
    "words",
]
"""What stands for an argument: names that the platform knows now, which completion offers; `words`: a command."""


class Argument(NamedTuple):
    """An argument as argparse takes it; `live` says what it names."""

    flags: tuple[str, ...]
    live: Live
    options: dict[str, Any]

    @property
    def positional(self) -> bool:
        return not self.flags[0].startswith("-")


class Command(NamedTuple):
    """`run` returns the exit status, None for 0. `remote` commands take the options that name a platform."""

    name: str  # one or two words, as `env create`
    help: str
    run: Callable[[Session, argparse.Namespace], int | None]
    arguments: tuple[Argument, ...] = ()
    examples: tuple[str, ...] = ()
    remote: bool = True


def argument(*flags: str, live: Live = "", **options: Any) -> Argument:
    return Argument(flags, live, options)


JSON = argument("--json", action="store_true", help="print JSON instead of a table")
OF = argument("--of", live="user", default="", metavar="USER", help="another user's (for those who may)")
LISTED = argument("--of", live="user", default="", metavar="USER|all", help="another user's, or everybody's")
PLATFORM = (
    argument("--context", live="context", default="", metavar="NAME", help="a platform that you have signed in to"),
    argument("--url", default="", help="entry of a platform, http://host:9000/, with RCE_KEY or RCE_PASSWORD"),
    argument("--user", default="", metavar="NAME", help="who you are there, with --url"),
)
ENVIRONMENT = argument("environment", live="environment", metavar="ENV", help="its containerTag")


class Usage(InvalidRequest):
    """The command line is wrong; the message says how it should be."""


class Parser(argparse.ArgumentParser):
    """An argparse parser whose errors are raised, since an interactive console goes on after them."""

    def error(self, message: str) -> NoReturn:
        raise Usage(f"{message}\n{self.format_usage().rstrip()}")


def parser(command: Command, prog: str = "rce", platform: bool = True) -> Parser:
    """The command line of one command; in a console the `platform` is the console's."""
    begin = f"{prog} ".lstrip()
    epilog = "\n".join(["examples:", *(f"  {begin}{each}".replace("%", "%%") for each in command.examples)])
    whole = Parser(
        prog=f"{prog} {command.name}".strip(),
        description=command.help,
        epilog=epilog if command.examples else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    for each in arguments_of(command, False):
        whole.add_argument(*each.flags, **each.options)
    if platform and command.remote:
        group = whole.add_argument_group("platform", "(default: the current context; see `rce context`)")
        for each in PLATFORM:
            group.add_argument(*each.flags, **each.options)
    return whole


def arguments_of(command: Command, platform: bool = True) -> tuple[Argument, ...]:
    return command.arguments + (PLATFORM if platform and command.remote else ())
