"""Cores of measured processes; real processes, real affinities."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

import psutil
import pytest

from rce.bench import cores
from rce.bench.cores import runs, set_apart

SLEEP = (sys.executable, "-c", "import time; print(flush=True); time.sleep(60)")


@pytest.fixture
def children() -> Iterator[list[int]]:
    """Two processes; this one has its cores back at the end."""
    processes = [subprocess.Popen(SLEEP, stdout=subprocess.PIPE) for _ in range(2)]
    for process in processes:
        assert process.stdout is not None
        process.stdout.readline()
    before = {thread.id: os.sched_getaffinity(thread.id) for thread in psutil.Process().threads()}
    yield [process.pid for process in processes]
    for thread, allowed in before.items():
        os.sched_setaffinity(thread, allowed)
    for process in processes:
        process.kill()
        process.communicate()


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="this machine has one core")
def test_measured_process_shares_no_core_with_others(children: list[int]) -> None:
    measured, other = children
    set_apart(lambda process: process.pid == measured)
    one, rest = os.sched_getaffinity(other), os.sched_getaffinity(measured)
    assert len(one) == 1
    assert not one & rest
    assert os.sched_getaffinity(0) == one
    set_apart(lambda process: process.pid == other)
    assert os.sched_getaffinity(other) == rest, "a second call divides the same cores"


def test_machine_with_one_core_stays_as_it_is(children: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    before = [os.sched_getaffinity(each) for each in children]
    monkeypatch.setattr(cores, "_cores", lambda: [0])
    set_apart(lambda process: True)
    assert [os.sched_getaffinity(each) for each in children] == before


def test_program_is_known_by_its_module() -> None:
    with subprocess.Popen((sys.executable, "-u", "-m", "http.server", "0"), stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()  # its arguments may be missing at first
            found = psutil.Process(process.pid)
            assert runs(found, "http.server")
            assert not runs(found, "http")
        finally:
            process.kill()
    assert not runs(psutil.Process(), "http.server")
