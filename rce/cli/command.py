"""Entries of the table of commands: commands, programs and groups of commands, and the parsers of commands."""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Callable, Sequence
from enum import Enum, auto
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

from rce.cli.arguments import SIGNED_IN, Argument, PlatformOptions
from rce.errors import InvalidRequest
from rce.spelling import did_you_mean

if TYPE_CHECKING:  # the session runs commands
    from rce.cli.session import ConsoleSession

LINE_WIDTH = 80  # of descriptions in help texts


class Section(Enum):
    """Section of `rce --help` that lists an entry."""

    LOCAL = auto()
    PLATFORM = auto()
    """Commands at a platform: the only ones that the interactive console has."""
    SERVER = auto()
    MASTER_FILES = auto()
    HIDDEN = auto()


class Lazy:
    """Function of a module that is imported at the first call."""

    def __init__(self, module: str, name: str) -> None:
        self._module = module
        self._name = name

    def load(self) -> Callable[..., Any]:
        """Import the module and return the function."""
        function: Callable[..., Any] = getattr(import_module(self._module), self._name)
        return function

    def __call__(self, *args: Any) -> Any:
        """Call the function."""
        return self.load()(*args)


class Command(NamedTuple):
    """Command whose arguments RCE parses.

    `run` returns the exit status, or None for 0. `arguments` is a function where computing them needs slow imports.
    """

    name: str  # one or two words, as `env create`
    help: str  # one sentence
    run: Callable[[ConsoleSession, argparse.Namespace], int | None]
    arguments: tuple[Argument, ...] | Callable[[], tuple[Argument, ...]] = ()
    examples: tuple[str, ...] = ()
    platform: PlatformOptions | None = SIGNED_IN
    section: Section = Section.PLATFORM
    description: str = ""  # more sentences, for the command's own help

    @property
    def in_console(self) -> bool:
        """True if the interactive console and its scripts have this command."""
        return self.section is Section.PLATFORM

    def all_arguments(self, in_console: bool = False) -> tuple[Argument, ...]:
        """Return the arguments, with those that select the platform; the console has selected one already."""
        own = self.arguments() if callable(self.arguments) else self.arguments
        return own if in_console or self.platform is None else own + self.platform.arguments


class Program(NamedTuple):
    """Program that parses its own command line.

    A program may have the name of a command: `selected_by` decides by the arguments whether they are the program's.
    """

    name: str
    help: str
    run: Callable[[list[str]], int]
    section: Section
    selected_by: Callable[[Sequence[str]], bool] = lambda arguments: True
    usage: str = ""  # in the list of commands; default: the name


class Group(NamedTuple):
    """Help of a first word that several commands share, as `bench`; without an entry the list names the commands."""

    name: str
    help: str
    description: str = ""


class UsageError(InvalidRequest):
    """Wrong command line; the message has the usage and the fault."""


class Parser(argparse.ArgumentParser):
    """An argparse parser that raises its errors, because an interactive console goes on after them."""

    def error(self, message: str) -> NoReturn:
        """Raise UsageError with the text that argparse would print, and the option nearest to an unknown one."""
        unknown = re.match(r"unrecognized arguments: (--[\w-]+)", message)
        hint = did_you_mean(unknown[1], self._option_string_actions) if unknown else ""
        raise UsageError(f"{self.format_usage()}{self.prog}: error: {message}{f': {hint}' if hint else ''}")


def parser(command: Command, prog: str = "rce", in_console: bool = False) -> Parser:
    """Return the parser of a command; in a console without the options that select a platform."""
    prefix = f"{prog} ".lstrip()
    epilog = "\n".join(["examples:", *(f"  {prefix}{example}" for example in command.examples)])
    description = [textwrap.fill(each, LINE_WIDTH) for each in (command.help, command.description) if each]
    result = Parser(
        prog=f"{prefix}{command.name}",
        description="\n\n".join(description),
        epilog=epilog if command.examples else None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=not command.in_console,  # elsewhere abbreviated options have always been accepted
    )
    for argument in command.all_arguments(in_console=True):
        result.add_argument(*argument.flags, **argument.options)
    if command.platform is not None and not in_console:
        group = result.add_argument_group("platform", command.platform.description)
        for argument in command.platform.arguments:
            group.add_argument(*argument.flags, **argument.options)
    return result
