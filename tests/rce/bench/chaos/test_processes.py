"""Processes of environments and nodes in /proc."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from rce.bench.chaos.processes import Process, age, kill_all, of_environments

SLEEP = "import sys; print(flush=True); sys.stdin.read()"


def start(words: list[str], variables: Mapping[str, str]) -> subprocess.Popen[bytes]:
    """Start a program, and wait for its execve(2) to end: during that it has neither words nor variables."""
    pipe = subprocess.PIPE
    process = subprocess.Popen([sys.executable, "-c", SLEEP, *words], stdin=pipe, stdout=pipe, env=variables)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def test_endpoints_and_nodes_are_found_by_their_directory(tmp_path: Path) -> None:
    inside = tmp_path / "environments" / "ann" / "e" / "run1"
    named = {**os.environ, "RCE_NAME": "ann/e", "RCE_DATA_DIR": str(inside)}
    commands = [
        (["endpoints.environment"], named),
        ([str(inside / "nodes" / "talker" / "parameters.yaml")], dict(os.environ)),
        (["endpoints.environment"], {**named, "RCE_DATA_DIR": "/elsewhere"}),
    ]
    started = [start(words, variables) for words, variables in commands]
    try:
        expected = {Process("e", "", started[0].pid), Process("e", "talker", started[1].pid)}
        assert set(of_environments(tmp_path, "ann")) == expected
        assert of_environments(tmp_path, "bob") == []
    finally:
        for process in started:
            process.communicate()


def test_all_processes_of_a_directory_are_killed(tmp_path: Path) -> None:
    commands = [([str(tmp_path / "a")], {}), ([], {"RCE_DATA_DIR": str(tmp_path)}), ([], {})]
    inside, around, other = [start(words, os.environ | variables) for words, variables in commands]
    assert kill_all(tmp_path) == 2
    assert [inside.wait(), around.wait()] == [-signal.SIGKILL] * 2
    other.communicate()
    assert other.returncode == 0


def test_age_of_a_process_grows() -> None:
    own = age(os.getpid())
    assert age(os.getppid()) >= own > 0  # the parent's later, since both may have begun in the same tick of the clock
    assert age(2**22 + 1) == 0
