"""`rce run`: a robot file until a signal."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

CODE = """
import asyncio, signal, sys
from rce.cli.lazy import run as command
from rce.cli.main import main

async def run_file(file):
    print("running", file)
    try:
        if sys.argv[2] == "fails.json":
            raise command_error
        signal.raise_signal(getattr(signal, SIGNAL))
        await asyncio.Event().wait()
    finally:
        print("cleaned up")

from rce.errors import InvalidRequest
command_error = InvalidRequest("the file has no robot")
command.run_file = run_file
sys.exit(main())
"""


def rce_run(file: Path | str, signal: str = "SIGINT") -> subprocess.CompletedProcess[str]:
    code = CODE.replace("SIGNAL)", f"{signal!r})")
    words = [sys.executable, "-P", "-c", code, "run", str(file)]
    return subprocess.run(words, capture_output=True, text=True, timeout=30, check=False)


@pytest.mark.parametrize("signal", ["SIGINT", "SIGTERM"])
def test_signal_ends_the_robot_in_order(signal: str) -> None:
    ended = rce_run("robot.json", signal)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.splitlines() == ["running robot.json", "cleaned up"]


def test_error_of_the_file_is_printed() -> None:
    ended = rce_run("fails.json")
    assert (ended.returncode, ended.stderr) == (1, "rce: the file has no robot\n")
