"""The program that starts a node's command: what it reports, and that the command dies with its parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

from endpoints.environment.node import LAUNCHER
from tests.support.endpoints.environment_driver import is_alive

PYTHON = (sys.executable, "-I", "-S")


def launch(*command: str, parent: int | None = None) -> tuple[int, str, str]:
    """Run a command; return its status and output, and what the launcher reports."""
    read, write = os.pipe()
    arguments = [*PYTHON, str(LAUNCHER), str(os.getpid() if parent is None else parent), str(write), *command]
    with subprocess.Popen(arguments, pass_fds=[write], stdout=subprocess.PIPE, text=True) as process:
        os.close(write)
        with os.fdopen(read) as report:
            reported = report.read()
        output, _ = process.communicate(timeout=60)
    return process.returncode, output, reported


def test_command_gets_the_signals_that_python_ignores() -> None:
    status, output, _ = launch("grep", "SigIgn", "/proc/self/status")
    ignored = int(output.split()[1], 16)
    assert status == 0
    assert not [each for each in (signal.SIGPIPE, signal.SIGXFSZ) if ignored >> (each - 1) & 1]


def test_command_replaces_launcher() -> None:
    assert launch("sh", "-c", "echo $0 $1; exit 3", "a b", "c") == (3, "a b c\n", "")


def test_reason_is_reported_if_command_cannot_be_executed() -> None:
    assert launch("/nowhere/node") == (1, "", "/nowhere/node: No such file or directory")
    assert launch("/etc/passwd") == (1, "", "/etc/passwd: Permission denied")


def test_command_does_not_start_after_death_of_parent() -> None:
    assert launch("echo", "alive", parent=1 << 22) == (1, "", "")


def test_report_is_closed_when_command_runs() -> None:
    read, write = os.pipe()
    arguments = [*PYTHON, str(LAUNCHER), str(os.getpid()), str(write), "sleep", "1000"]
    with subprocess.Popen(arguments, pass_fds=[write]) as process:
        os.close(write)
        with os.fdopen(read) as report:
            assert report.read() == ""  # waits for the end
        assert process.poll() is None
        process.kill()


def test_command_dies_with_its_parent() -> None:
    start = (
        "import os, subprocess, sys\n"
        f"launcher = [*{PYTHON!r}, {str(LAUNCHER)!r}, str(os.getpid()), '1']\n"
        "subprocess.Popen([*launcher, 'sh', '-c', 'echo $$ >&2; exec sleep 1000'])\n"
        "sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", start], stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stderr is not None
        pid = int(parent.stderr.readline())
        parent.send_signal(signal.SIGKILL)
        assert parent.stderr.read() == ""  # the command has the pipe, too, so this waits for its end
    deadline = time.monotonic() + 60
    while is_alive(pid):
        assert time.monotonic() < deadline
