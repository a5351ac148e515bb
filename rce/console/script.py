"""Lines of commands: those typed at the console, and scripts."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable

from rce.console import run
from rce.console.session import Session

LEAVE = ("exit", "quit")


def carry_out(line: str, session: Session) -> int:
    """One line; empty ones and comments do nothing. SystemExit for `exit`."""
    try:
        words = shlex.split(line, comments=True)
    except ValueError as error:
        print(f"the line cannot be read: {error}", file=sys.stderr)
        return run.WRONG
    if words[:1] == ["rce"]:  # as it is written elsewhere
        words = words[1:]
    if not words:
        return run.DONE
    if words[0] in LEAVE:
        raise SystemExit(run.DONE)
    return run.run(words, session)


def run_script(lines: Iterable[str], session: Session, name: str = "<stdin>", keep_going: bool = False) -> int:
    """Carry out a script; the status is that of the first line that failed, and ends it unless told to keep going."""
    first = run.DONE
    for number, line in enumerate(lines, 1):
        try:
            status = carry_out(line, session)
        except SystemExit:
            return first
        if status:
            print(f"{name}:{number}: status {status}: {line.strip()}", file=sys.stderr)
            first = first or status
            if not keep_going or status == run.STOPPED:
                return first
    return first
