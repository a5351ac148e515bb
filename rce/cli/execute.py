"""Execution of one command line, with errors as text on standard error and an exit status."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from rce.cli import table
from rce.cli.arguments import ENVIRONMENT
from rce.cli.command import Command, UsageError, parser
from rce.cli.original import help_of, translate
from rce.cli.session import ConsoleSession
from rce.errors import RceError, describe_os_error
from rce.spelling import did_you_mean

SYNONYMS = (
    frozenset({"remove", "delete", "destroy", "rm", "del"}),
    frozenset({"add", "create", "make", "new"}),
    frozenset({"start", "run", "launch"}),
    frozenset({"list", "ls"}),
    frozenset({"show", "info", "inspect", "describe"}),
)
"""Verbs of the same meaning: those of commands, and what users may type in their place."""
SUCCESS, FAILURE, USAGE_ERROR, INTERRUPTED = 0, 1, 2, 130


def run(words: Sequence[str], session: ConsoleSession | None = None) -> int:
    """Run a command line and return its exit status, one of those above or the command's own.

    Args:
        words: The command line without `rce`.
        session: That of the interactive console or script that the line belongs to; None on the command line of a
            shell, where the words select the platform.
    """
    prefix = words[0] if session else "rce"
    try:
        return _run(words, session)
    except UsageError as error:
        return _fail(str(error), USAGE_ERROR)
    except RceError as error:
        return _fail(f"{prefix}: {error}", FAILURE)
    except OSError as error:
        if error.filename is None:  # not a file that the user named, but standard output
            raise
        return _fail(f"{prefix}: {describe_os_error(error)}", FAILURE)
    except KeyboardInterrupt:
        return INTERRUPTED


def print_help(words: Sequence[str], in_console: bool) -> int:
    """Print the help of a command, a group of commands or a program, and return the exit status."""
    words, prog = translate(words), "" if in_console else "rce"
    command, _ = table.find_command(words, in_console)
    if command is not None:
        print(parser(command, prog, in_console).format_help(), end="")
        return SUCCESS
    if table.commands_of(words[0], in_console) or (in_console and help_of(words[0])):
        return _run_group([*words, "--help"], prog, in_console)
    program = None if in_console else table.PROGRAMS.get(words[0])
    return program.run(["--help"]) if program is not None else _unknown(words[0], in_console)


def _run(words: Sequence[str], session: ConsoleSession | None) -> int:
    in_console, prog = session is not None, "" if session else "rce"
    program = None if in_console else table.find_program(words)
    if program is not None:
        return program.run(list(words[1:]))
    words = translate(words)
    command, arguments = table.find_command(words, in_console)
    if command is None:
        return _run_group(words, prog, in_console)
    try:
        args = parser(command, prog, in_console).parse_args(split_address(command, arguments))
    except SystemExit:  # argparse, after --help; it raises UsageError otherwise
        return SUCCESS
    return command.run(session or ConsoleSession.from_arguments(args), args) or SUCCESS


def _run_group(words: Sequence[str], prog: str, in_console: bool) -> int:
    """Print the commands of a first word; the second word is not one of them."""
    word, *rest = words
    if not table.commands_of(word, in_console):
        original = help_of(word)
        if not original:
            return _unknown(word, in_console)
        if rest and rest[0] in ("-h", "--help", "help"):
            print(original)
            return SUCCESS
        return _fail(original, USAGE_ERROR)
    text = table.group_help(word, prog, in_console)
    if not rest or rest[0] in ("-h", "--help", "help"):
        print(text)
        return SUCCESS if rest else USAGE_ERROR
    verbs = [each.name.partition(" ")[2] for each in table.commands_of(word, in_console)]
    meant = next((verb for same in SYNONYMS if rest[0] in same for verb in verbs if verb in same), "")
    hint = f"did you mean {meant}?" if meant else did_you_mean(rest[0], verbs)
    problem = f"{'console' if in_console else 'rce'}: there is no command '{word} {rest[0]}'"
    return _fail(problem + (f": {hint}" if hint else f"\n\n{text}"), USAGE_ERROR)


def split_address(command: Command, arguments: Sequence[str]) -> list[str]:
    """Return the arguments with `ENV/NAME` as two words where the command takes ENV and NAME."""
    positional = [each for each in command.all_arguments() if each.positional]
    index = _first_positional(command, arguments)
    if len(positional) > 1 and positional[0] is ENVIRONMENT and index is not None:
        environment, slash, name = arguments[index].partition("/")
        if slash:
            return [*arguments[:index], environment, name, *arguments[index + 1 :]]
    return list(arguments)


def _first_positional(command: Command, arguments: Sequence[str]) -> int | None:
    """Return the index of the first argument that is neither an option nor the value of one."""
    with_value = {flag for each in command.all_arguments() if each.takes_value for flag in each.flags}
    is_value = False
    for index, word in enumerate(arguments):
        if is_value:
            is_value = False
        elif word in with_value:
            is_value = True
        elif not word.startswith("-"):
            return index
    return None


def _unknown(word: str, in_console: bool) -> int:
    hint = did_you_mean(word, table.first_words(in_console))
    if hint:
        return _fail(f"{'console' if in_console else 'rce'}: there is no command {word!r}: {hint}", USAGE_ERROR)
    if in_console:
        return _fail(f"console: there is no command {word!r}; `help` lists them", USAGE_ERROR)
    return _fail(f"rce: there is no command {word!r}\n\n{table.overview()}", USAGE_ERROR)


def _fail(text: str, status: int) -> int:
    print(text, file=sys.stderr)
    return status
