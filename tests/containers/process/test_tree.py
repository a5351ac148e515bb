"""Processes of an environment: how they are found, watched and killed."""

from __future__ import annotations

import asyncio
import os
import secrets
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from containers.process import tree
from containers.process.tree import MARKER, Watch, describe_end, environ, has_marker, kill_marked, marked
from rce.errors import TimedOut

RUN = secrets.token_hex(16)  # unique, as in other tests that run at the same time


class Program:
    """Processes `sleep`, which are killed after the test."""

    def __init__(self) -> None:
        self.started: list[subprocess.Popen[bytes]] = []

    def start(self, run: str = RUN, script: str = "exec sleep 1000") -> subprocess.Popen[bytes]:
        words = ["sh", "-c", f"echo; {script}"]
        child = subprocess.Popen(words, env={**os.environ, MARKER: run}, stdout=subprocess.PIPE, start_new_session=True)
        self.started.append(child)
        assert child.stdout is not None
        child.stdout.readline()
        return child


@pytest.fixture
def program() -> Iterator[Program]:
    program = Program()
    yield program
    for child in program.started:
        child.kill()
        child.communicate()


def test_processes_of_a_run_are_found_by_their_variable(program: Program) -> None:
    own, other = program.start(), program.start(secrets.token_hex(16))
    assert has_marker(own.pid, RUN)
    assert not has_marker(other.pid, RUN)
    assert not has_marker(own.pid, RUN[:-1])
    assert marked(RUN) == [own.pid]


async def test_all_processes_of_a_run_are_killed_and_no_others(program: Program) -> None:
    own = program.start(script="setsid sleep 1000 & exec sleep 1000")
    other = program.start(secrets.token_hex(16))
    await kill_marked(RUN)
    assert marked(RUN) == []
    assert own.wait() == -signal.SIGKILL
    assert other.poll() is None


async def test_process_that_survives_being_killed_is_reported(
    program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    program.start()
    monkeypatch.setattr(tree, "KILL_TIMEOUT", 0.05)
    monkeypatch.setattr(tree, "_kill", lambda pid, run: None)
    with pytest.raises(TimedOut, match=RUN):
        await kill_marked(RUN)


async def test_reused_pid_is_not_killed(program: Program) -> None:
    other = program.start(secrets.token_hex(16))
    tree._kill(other.pid, RUN)
    assert other.poll() is None


def test_process_that_is_gone_has_no_variables(program: Program) -> None:
    child = program.start(script="exit")
    child.wait()
    assert environ(child.pid) == []
    tree._kill(child.pid, RUN)  # does nothing


def test_variables_are_read_again_after_execve(program: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    """They were not there yet when they were read, and execve(2) ended before its state was read."""
    child, read, reads = program.start(), Path.read_bytes, 0

    def read_early(path: Path) -> bytes:
        nonlocal reads
        reads += 1
        return read(path) if reads > 1 else b""

    monkeypatch.setattr(Path, "read_bytes", read_early)
    assert has_marker(child.pid, RUN)


@pytest.mark.parametrize(
    ("size", "end_of_code", "begin", "end", "has_variables"),
    [
        (1, 9, 5, 7, True),
        (1, 0, 0, 0, True),
        (1, 0, 5, 5, True),
        (1, 9, 5, 5, False),
        (0, 0, 0, 0, False),
    ],
    ids=["running", "execve begun", "execve at the variables", "none", "zombie"],
)
def test_process_during_execve_may_have_variables(
    tmp_path: Path, size: int, end_of_code: int, begin: int, end: int, has_variables: bool
) -> None:
    fields = ["0"] * 50
    for place, value in ((20, size), (24, end_of_code), (47, begin), (48, end)):
        fields[place] = str(value)
    (tmp_path / "stat").write_text(f"7 (a) b) {' '.join(fields)}\n")
    assert tree._has_variables(tmp_path) == has_variables


def test_process_without_variables_has_none() -> None:
    with subprocess.Popen(["sleep", "1000"], env={}) as child:
        assert [each for each in environ(child.pid) if each] == []
        child.kill()


async def test_end_of_a_watched_process_is_reported_once(program: Program) -> None:
    ends: list[str] = []
    child = program.start()
    watch = Watch(child.pid, lambda: ends.append("ended"))
    assert ends == []
    watch.send(signal.SIGTERM)
    await asyncio.wait_for(watch.ended.wait(), 60)
    assert ends == ["ended"]
    assert child.wait() == -signal.SIGTERM
    watch.close()


async def test_closed_watch_reports_nothing(program: Program) -> None:
    ends: list[str] = []
    child = program.start()
    closed, open_ = Watch(child.pid, lambda: ends.append("closed")), Watch(child.pid, lambda: ends.append("open"))
    closed.close()
    child.kill()
    await asyncio.wait_for(open_.ended.wait(), 60)
    assert ends == ["open"]
    assert not closed.ended.is_set()


async def test_process_that_is_gone_cannot_be_watched(program: Program) -> None:
    child = program.start(script="exit")
    child.wait()
    with pytest.raises(ProcessLookupError):
        Watch(child.pid, lambda: None)


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (0, "ended with status 0"),
        (3, "ended with status 3"),
        (-9, "was killed by signal 9 (Killed)"),
        (None, "ended; its exit status is not known, because an earlier task set started it"),
    ],
)
def test_end_is_described(status: int | None, words: str) -> None:
    assert describe_end(status) == words
