"""Random faults, and processes that fail."""

from __future__ import annotations

import asyncio
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rce.bench.chaos import faults
from rce.bench.chaos.faults import Fault, Nemesis, choose
from rce.errors import TimedOut, Unavailable
from tests.support.e2e.real_platform import until


def chosen(seed: int, *, disks: bool = True, long: bool = True) -> list[Fault]:
    rng = random.Random(seed)
    return [choose(rng, ["e"], disks, long) for _ in range(500)]


def test_seed_determines_the_faults() -> None:
    assert chosen(1) == chosen(1)
    assert chosen(1) != chosen(2)


def test_every_kind_of_process_fails_in_every_way() -> None:
    labels = {fault.label for fault in chosen(1)}
    victims = {"Master", "Robot endpoint", "task set", "map service", "environment", "node"}
    assert labels == {f"{victim} {how}" for victim in victims for how in ("killed", "stopped")} | {
        f"{victim} disk full" for victim in victims - {"environment", "node"}
    }


def test_disks_and_long_stops_can_be_left_out() -> None:
    found = chosen(1, disks=False, long=False)
    assert {fault.kind for fault in found} == {"kill", "stop"}
    assert max(fault.seconds for fault in found) <= faults.STOPS[1]


def test_fault_reads_as_a_sentence() -> None:
    assert str(Fault("stop", "node of e", 1.5)) == "node of e stopped for 1.5 s"
    assert str(Fault("kill", "master", 0.0)) == "master killed"


@pytest.fixture
def victim(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Process that has the directory of the platform on its command line."""
    process = subprocess.Popen([sys.executable, "-c", "input()", str(tmp_path)], stdin=subprocess.PIPE)
    yield process
    process.communicate()


def nemesis(tmp_path: Path, pid: int, probe: Any = None) -> Nemesis:
    platform: Any = SimpleNamespace(processes={"master": SimpleNamespace(pid=pid)}, directory=tmp_path, disks={})
    return Nemesis(platform, {"master": probe})


async def test_killed_process_ends(tmp_path: Path, victim: subprocess.Popen[bytes]) -> None:
    await nemesis(tmp_path, victim.pid).strike(Fault("kill", "master", 0.0))
    assert await asyncio.to_thread(victim.wait) == -signal.SIGKILL


async def test_stopped_process_runs_again(tmp_path: Path, victim: subprocess.Popen[bytes]) -> None:
    def state() -> str:
        return Path(f"/proc/{victim.pid}/stat").read_text().rpartition(")")[2].split()[0]

    striking = asyncio.create_task(nemesis(tmp_path, victim.pid).strike(Fault("stop", "master", 1.0)))
    await until(lambda: state() == "T")
    await striking
    await until(lambda: state() != "T")


async def test_process_of_another_program_is_not_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The pid of a process that has ended may be another's."""
    monkeypatch.setattr(faults, "RECOVERY_TIMEOUT", 0)
    with pytest.raises(TimedOut, match="master does not run"):
        await nemesis(tmp_path / "other", os.getpid()).strike(Fault("kill", "master", 0.0))


async def test_recovery_is_the_time_until_the_probe_succeeds(tmp_path: Path) -> None:
    failures = [Unavailable("away")] * 3

    async def probe(since: float) -> None:
        if failures:
            raise failures.pop()

    fault = Fault("kill", "master", 0.0)
    ended = time.monotonic()
    assert 0 < await nemesis(tmp_path, 0, probe).recovered(fault, ended) <= time.monotonic() - ended


async def test_victim_that_does_not_recover_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def probe(since: float) -> None:
        raise Unavailable("away")

    monkeypatch.setattr(faults, "RECOVERY_TIMEOUT", 0.05)
    with pytest.raises(TimedOut, match=r"master killed: not recovered 0\.05 s after its end: away"):
        await nemesis(tmp_path, 0, probe).recovered(Fault("kill", "master", 0.0), time.monotonic())
