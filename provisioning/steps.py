"""Steps that the commands of `provision` consist of, each executed only if it is needed. Standard library only."""

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
CONSTRAINTS = ROOT / "provisioning" / "constraints.txt"  # exact versions of all dependencies
NAME_COLUMNS = 16  # for the name of a step, which a space follows


class ProvisioningError(Exception):
    """A step failed. The message says why, and what to do."""


@dataclass(frozen=True)
class Step:
    """One step of a command.

    Attributes:
        name: Short name, printed before the outcome.
        todo: Returns a description of the work that is left, or "" if there is none.
        action: Does the work. Returns a remark for the user, or "".
    """

    name: str
    todo: Callable[[], str]
    action: Callable[[], str]


def run_steps(steps: Sequence[Step]) -> None:
    """Run the steps in order and print one line for each.

    Raises:
        ProvisioningError: A step failed; those after it were not started.
    """
    for step in steps:
        start = time.monotonic()
        if not step.todo():
            print(f"{step.name:<{NAME_COLUMNS}} already done", flush=True)
            continue
        print(f"{step.name:<{NAME_COLUMNS}} ", end="", flush=True)
        try:
            remark = step.action()
        except ProvisioningError:
            show_progress("")
            print("failed", flush=True)
            raise
        show_progress("")
        print(f"{remark or 'done'} ({time.monotonic() - start:.1f} s)", flush=True)


def show_progress(line: str) -> None:
    """On a terminal, print a line of a program's output behind the step's name, in place of the previous one."""
    if sys.stdout.isatty():
        room = shutil.get_terminal_size().columns - NAME_COLUMNS - 2
        text = "".join(filter(str.isprintable, line))[: max(room, 0)]
        print(f"\x1b[{NAME_COLUMNS + 2}G\x1b[K{text}", end="", flush=True)


def print_plan(steps: Sequence[Step], *commands: Sequence[str]) -> None:
    """Print what `run_steps` would do, and the commands that would be run after it."""
    for step in steps:
        print(f"{step.name:<{NAME_COLUMNS}} {step.todo() or 'already done'}")
    for command in commands:
        print(f"{'run':<{NAME_COLUMNS}} {shlex.join(command)}")


def check_step(name: str, *command: str | Path) -> Step:
    """Return a step that runs a program, whose output is printed only if it fails."""

    def action() -> str:
        run(*command)
        return ""

    return Step(name, lambda: shlex.join(map(str, command)), action)


def start_log() -> None:
    """Create the log, or empty it."""
    LOG.parent.mkdir(exist_ok=True)
    LOG.write_text("")


def run(*command: str | Path, environment: Mapping[str, str] | None = None, secret: str | None = None) -> str:
    """Run a program, with its output in the log.

    Args:
        command: The program and its arguments.
        environment: Variables to set in addition to those of this process.
        secret: The program's standard input. If given, neither arguments nor output are written to the log.

    Returns:
        The program's output, standard error included.

    Raises:
        ProvisioningError: The program cannot be run or failed.
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
            raise ProvisioningError(f"{words[0]} cannot be run: {error}") from None
        with program:
            assert program.stdin is not None
            assert program.stdout is not None
            with contextlib.suppress(BrokenPipeError):
                program.stdin.write(secret or "")
                program.stdin.close()
            for line in program.stdout:
                lines.append(line)
                if secret is None:
                    show_progress(line)
                    log.write(line)
                    log.flush()
    if program.returncode:
        rest = f"; the whole output is in {LOG}" if secret is None else ""
        raise ProvisioningError(f"{''.join(lines[-30:])}\n{shown}\nexited with status {program.returncode}{rest}")
    return "".join(lines)


def pip_install(python: str | Path, *arguments: str | Path) -> None:
    """Install packages by pip in the versions of constraints.txt, those that builds need included.

    Raises:
        ProvisioningError: pip failed.
    """
    command = (python, "-m", "pip", "install", "--disable-pip-version-check", "--no-input", "-c", CONSTRAINTS)
    run(*command, *arguments, environment=pip_environment())


def pip_environment() -> dict[str, str]:
    """Return variables by which pip also constrains the packages that it builds wheels with.

    They go to an environment of their own, to which option -c does not apply. pip 25.3 and later read
    PIP_BUILD_CONSTRAINT, earlier versions PIP_CONSTRAINT. Both may be lists separated by spaces, hence the URI.
    """
    return {"PIP_CONSTRAINT": CONSTRAINTS.as_uri(), "PIP_BUILD_CONSTRAINT": CONSTRAINTS.as_uri()}


def add_command(
    commands: Commands,
    function: Callable[[argparse.Namespace, list[str]], int],
    name: str = "",
    passes_on: bool = False,
) -> argparse.ArgumentParser:
    """Add a subcommand.

    Args:
        commands: The subcommands of the parser.
        function: Executes the subcommand and returns its exit status. Its docstring is the help text.
        name: The subcommand's name, if it is not the function's.
        passes_on: Pass unknown arguments to the function instead of refusing them.
    """
    command = commands.add_parser(
        name or function.__name__, help=function.__doc__, description=function.__doc__, allow_abbrev=False
    )
    command.set_defaults(function=function, passes_on=passes_on)
    command.add_argument("--dry-run", action="store_true", help="print the plan and change nothing")
    return command


def check_python() -> None:
    """Check that RCE runs on this version of Python.

    Raises:
        ProvisioningError: It does not.
    """
    if not (3, 11) <= sys.version_info[:2] <= (3, 13):
        raise ProvisioningError(
            f"this is Python {sys.version.split()[0]}; RCE runs on 3.11 to 3.13, for example: python3.12 {sys.argv[0]}"
        )


def need_root(command: str) -> None:
    """Check that the process runs as root.

    Raises:
        ProvisioningError: It does not.
    """
    if os.geteuid() != 0:
        raise ProvisioningError(
            f"{command} changes this system: run it as root (sudo provisioning/provision …), or with --dry-run"
        )
