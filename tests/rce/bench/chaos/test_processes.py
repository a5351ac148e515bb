"""Processes of environments and nodes in /proc."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from rce.bench.chaos.processes import Process, age, kill_all, of_environments

SLEEP = "import sys; sys.stdin.read()"


def test_endpoints_and_nodes_are_found_by_their_directory(tmp_path: Path) -> None:
    inside = tmp_path / "environments" / "ann" / "e" / "run1"
    named = {**os.environ, "RCE_NAME": "ann/e", "RCE_DATA_DIR": str(inside)}
    commands = [
        (["endpoints.environment"], named),
        ([str(inside / "nodes" / "talker" / "parameters.yaml")], dict(os.environ)),
        (["endpoints.environment"], {**named, "RCE_DATA_DIR": "/elsewhere"}),
    ]
    started = [
        subprocess.Popen([sys.executable, "-c", SLEEP, *words], stdin=subprocess.PIPE, env=env)
        for words, env in commands
    ]
    try:
        expected = {Process("e", "", started[0].pid), Process("e", "talker", started[1].pid)}
        assert set(of_environments(tmp_path, "ann")) == expected
        assert of_environments(tmp_path, "bob") == []
    finally:
        for process in started:
            process.communicate()


def test_all_processes_of_a_directory_are_killed(tmp_path: Path) -> None:
    commands = [([str(tmp_path / "a")], {}), ([], {"RCE_DATA_DIR": str(tmp_path)}), ([], {})]
    inside, around, other = [
        subprocess.Popen([sys.executable, "-c", SLEEP, *words], stdin=subprocess.PIPE, env=os.environ | env)
        for words, env in commands
    ]
    assert kill_all(tmp_path) == 2
    assert [inside.wait(), around.wait()] == [-signal.SIGKILL] * 2
    other.communicate()
    assert other.returncode == 0


def test_age_of_a_process_grows() -> None:
    assert age(os.getppid()) >= age(os.getpid()) > 0
    assert age(2**22 + 1) == 0
