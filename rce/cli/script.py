"""Execution of lines of commands: those typed at the console, and scripts."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable

from rce.cli import execute
from rce.cli.session import ConsoleSession

EXIT_COMMANDS = ("exit", "quit")


def run_line(line: str, session: ConsoleSession) -> int:
    """Run one line, if it is not empty or a comment, and return the exit status.

    Raises:
        SystemExit: The line is `exit` or `quit`.
    """
    try:
        words = shlex.split(line, comments=True)
    except ValueError as error:
        print(f"cannot parse the line: {error}", file=sys.stderr)
        return execute.USAGE_ERROR
    if words[:1] == ["rce"]:  # copied from a shell
        words = words[1:]
    if not words:
        return execute.SUCCESS
    if words[0] in EXIT_COMMANDS:
        raise SystemExit(execute.SUCCESS)
    return execute.run(words, session)


def run_script(lines: Iterable[str], session: ConsoleSession, name: str = "<stdin>", keep_going: bool = False) -> int:
    """Run the lines of a script and return the status of the first one that failed, or 0.

    A failed line ends the script unless `keep_going` is set; Ctrl-C and `exit` always do.
    """
    first_failure = execute.SUCCESS
    for number, line in enumerate(lines, 1):
        try:
            status = run_line(line, session)
        except SystemExit:
            return first_failure
        if status:
            print(f"{name}:{number}: status {status}: {line.strip()}", file=sys.stderr)
            first_failure = first_failure or status
            if not keep_going or status == execute.INTERRUPTED:
                return first_failure
    return first_failure
