"""Programs on a pseudo-terminal."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import pytest

from rce.protocol.terminal import Request

LIMIT = 60.0  # seconds until a test gives up
Start = Callable[..., Any]


@pytest.fixture
def start(load: Callable[[str, str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> Iterator[Start]:
    """`start("command")` starts a command on a terminal of 24 rows and 80 columns."""
    module = load("rce_shell", "process")
    monkeypatch.setattr(module, "KILL_AFTER", 0.2)
    started: list[Any] = []

    def start(command: str, rows: int = 24, columns: int = 80) -> Any:
        started.append(module.Process(Request(rows, columns, "xterm", command)))
        return started[-1]

    yield start
    for each in started:
        each.end()


def output_until(process: Any, text: bytes) -> bytes:
    """Read the output of a program until it contains a text."""
    found, end = b"", time.monotonic() + LIMIT
    while text not in found:
        assert time.monotonic() < end, found
        select.select([process.master], [], [], 1.0)
        found += process.read(65536)
    return found


def status_of(process: Any) -> tuple[int, bytes]:
    """Wait for the end of a program; return its status and its output."""
    found, end = b"", time.monotonic() + LIMIT
    while process.status is None:
        assert time.monotonic() < end, found
        select.select([process.master], [], [], 0.01)
        found += process.read(65536)
    return process.status, found


def test_program_has_a_terminal_of_the_requested_size(start: Start) -> None:
    status, output = status_of(start("tty && stty size && echo term $TERM", 50, 132))
    name, size, term = output.decode().splitlines()
    assert (status, name[:9], size, term) == (0, "/dev/pts/", "50 132", "term xterm")


@pytest.mark.parametrize(("command", "status"), [("exit 3", 3), ("kill -TERM $$", 128 + 15), ("no-such-program", 127)])
def test_status_of_the_program(start: Start, command: str, status: int) -> None:
    assert status_of(start(command))[0] == status


def test_status_comes_after_all_output(start: Start) -> None:
    process = start("seq 1000")
    assert os.waitid(os.P_PID, process._child.pid, os.WEXITED | os.WNOWAIT)
    assert (process.status, process.ended) == (None, 0.0)
    status, output = status_of(process)
    assert (status, output.split()[-1]) == (0, b"1000")
    assert process.ended > 0


def test_without_a_command_it_is_a_shell(start: Start) -> None:
    process = start("")
    process.write(b"echo $((40 + 2))\nexit 7\n")
    status, output = status_of(process)
    assert status == 7
    assert b"42" in output


def test_read_returns_at_once_and_no_more_than_asked_for(start: Start) -> None:
    process = start("read line; printf 0123456789; read line")
    assert process.read(100) == b""
    assert process.write(b"go\n") == 3
    found, end = b"", time.monotonic() + LIMIT
    while b"6789" not in found:
        assert time.monotonic() < end
        select.select([process.master], [], [], 1.0)
        part = process.read(4)
        assert len(part) <= 4
        found += part


def test_write_returns_what_the_terminal_accepts(start: Start) -> None:
    process = start("stty raw -echo; echo ready; sleep 1000")
    output_until(process, b"ready")
    accepted = 0
    while part := process.write(b"x" * 4096):
        accepted += part
        assert accepted < 1_000_000, "the program reads nothing"
    assert accepted > 0


def test_program_ends_when_nobody_reads_its_output(start: Start) -> None:
    """It gets SIGPIPE, 13, as in any terminal."""
    status, output = status_of(start('yes | head -n 1; echo "status ${PIPESTATUS[0]}"'))
    assert (status, output) == (0, b"y\r\nstatus 141\r\n")


def test_program_sees_new_sizes(start: Start) -> None:
    process = start("trap 'stty size' WINCH; echo ready; while :; do read -t 0.1 line; done")
    output_until(process, b"ready")
    process.resize(10, 20)
    assert b"10 20" in output_until(process, b"10 20")


def test_interrupt_reaches_the_program(start: Start) -> None:
    process = start("trap 'echo interrupted; exit 5' INT; echo ready; while :; do read -t 0.1 line; done")
    output_until(process, b"ready")
    process.write(b"\x03")
    status, output = status_of(process)
    assert status == 5
    assert b"interrupted" in output


def test_whole_session_ends(load: Callable[[str, str], ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    """The hang-up ends what does not handle it; the rest is killed."""
    module = load("rce_shell", "process")
    monkeypatch.setattr(module, "KILL_AFTER", 0.2)
    command = "(trap '' HUP; echo deaf $BASHPID; exec sleep 1000) & sleep 1000 & echo child $!; echo ready; wait"
    process = module.Process(Request(24, 80, "xterm", command))
    output = b""
    while output.count(b"\n") < 3:
        output += output_until(process, b"\n")
    words = output.decode().split()
    handles = [os.pidfd_open(int(words[words.index(name) + 1])) for name in ("deaf", "child")]
    assert not select.select(handles, [], [], 0)[0], "both run"
    process.end()
    for handle in handles:
        assert select.select([handle], [], [], LIMIT)[0], "it has ended"
        os.close(handle)
    assert process._child.returncode is not None
