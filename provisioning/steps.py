"""What all commands of `provision` are made of: steps that are done only if they are needed. Standard library only."""

from __future__ import annotations

import argparse
import contextlib
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

ROOT = Path(__file__).resolve().parent.parent  # the checkout
LOG = ROOT / "build" / "provision.log"
NAMED = 17  # columns of a step's name


class Failed(Exception):
    """A step failed; the message says why and what to do."""


@dataclass(frozen=True)
class Step:
    """One thing to do. `todo` says in words what is to be done, "" if nothing; `action` does it and may comment."""

    name: str
    todo: Callable[[], str]
    action: Callable[[], str]


def perform(steps: Sequence[Step]) -> None:
    """Run the steps in order, one printed line each; raises Failed at the first that does not succeed."""
    for step in steps:
        start = time.monotonic()
        if not step.todo():
            print(f"{step.name:<16} already done", flush=True)
            continue
        print(f"{step.name:<16} ", end="", flush=True)
        try:
            remark = step.action()
        except Failed:
            glimpse("")
            print("failed", flush=True)
            raise
        glimpse("")
        print(f"{remark or 'done'} ({time.monotonic() - start:.1f} s)", flush=True)


def glimpse(line: str) -> None:
    """On a terminal, what a step is at, behind its name; the next one takes its place."""
    if sys.stdout.isatty():
        room = shutil.get_terminal_size().columns - NAMED - 1
        text = "".join(filter(str.isprintable, line))[: max(room, 0)]
        print(f"\x1b[{NAMED + 1}G\x1b[K{text}", end="", flush=True)


def show(steps: Sequence[Step], final: Sequence[str] = ()) -> None:
    """The plan: what `perform` would do, and the program that would have the terminal then."""
    for step in steps:
        print(f"{step.name:<16} {step.todo() or 'already done'}")
    if final:
        print(f"{'run':<16} {shlex.join(final)}")


def check_step(name: str, *command: str | Path) -> Step:
    """A program whose output is of interest only if it fails."""

    def action() -> str:
        run(*command)
        return ""

    return Step(name, lambda: shlex.join(map(str, command)), action)


def begin_log() -> None:
    LOG.parent.mkdir(exist_ok=True)
    LOG.write_text("")


def run(*command: str | Path, environment: Mapping[str, str] | None = None, secret: str | None = None) -> str:
    """Run a program with its output in the log; returns what it printed. Raises Failed.

    With `secret`, which becomes its input, neither its arguments nor its output go to the log.
    """
    words = list(map(str, command))
    shown = shlex.join(words) if secret is None else f"{words[0]} …"
    pipe = subprocess.PIPE
    lines: list[str] = []
    with LOG.open("a") as log:
        print(f"\n$ {shown}", file=log, flush=True)
        try:
            program = subprocess.Popen(
                words,
                cwd=ROOT,
                env={**os.environ, **(environment or {})},
                stdin=pipe,
                stdout=pipe,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
            )
        except OSError as error:
            raise Failed(f"{words[0]} cannot be run: {error}") from None
        with program:
            assert program.stdin is not None
            assert program.stdout is not None
            with contextlib.suppress(BrokenPipeError):
                program.stdin.write(secret or "")
                program.stdin.close()
            for line in program.stdout:
                lines.append(line)
                if secret is None:
                    glimpse(line)
                    log.write(line)
                    log.flush()
    if program.returncode:
        rest = f"; all of its output is in {LOG}" if secret is None else ""
        raise Failed(f"{''.join(lines[-30:])}\n{shown}\nended with status {program.returncode}{rest}")
    return "".join(lines)


def add_command(
    commands: Commands,
    function: Callable[[argparse.Namespace, list[str]], int],
    name: str = "",
    passes_on: bool = False,
) -> argparse.ArgumentParser:
    """A subcommand that `function` carries out and whose docstring says what it does.

    With `passes_on`, arguments that it does not know are for the program that it ends with.
    """
    command = commands.add_parser(
        name or function.__name__, help=function.__doc__, description=function.__doc__, allow_abbrev=False
    )
    command.set_defaults(function=function, passes_on=passes_on)
    command.add_argument("--dry-run", action="store_true", help="print what would be done, and do nothing")
    return command


def check_python() -> None:
    if not (3, 11) <= sys.version_info[:2] <= (3, 13):
        raise Failed(
            f"this is Python {sys.version.split()[0]}; RCE runs on 3.11 to 3.13, for example: python3.12 {sys.argv[0]}"
        )


def need_root(what: str) -> None:
    if os.geteuid() != 0:
        raise Failed(f"{what} changes this system: run it as root (sudo provisioning/provision …), or with --dry-run")
