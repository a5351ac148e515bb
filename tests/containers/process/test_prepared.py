"""Prepared endpoints: how many wait, what one gets when it is taken, and that none is left."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from containers.process import domains, prepared
from containers.process.domains import Domains
from containers.process.prepared import Pool

ECHO = "import sys, os; line = sys.stdin.readline(); open(os.environ['OUT'], 'a').write(line)"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out"


@pytest.fixture
async def pool(tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Pool]:  # type: ignore[misc]
    monkeypatch.setattr(prepared, "COMMAND", (sys.executable, "-I", "-S", "-c", ECHO))
    monkeypatch.setattr(prepared, "REFILL", 0.0)
    monkeypatch.setattr(domains, "_in_use", set)  # by other platforms on this machine
    pool = Pool(2, Domains(tmp_path / "domains", range(1, 4)), {"OUT": str(out)})
    pool.fill()
    yield pool
    pool.close()


async def test_one_that_is_taken_gets_its_environment_and_is_replaced(pool: Pool, out: Path, tmp_path: Path) -> None:
    first = pool.take()
    assert first is not None
    first.begin({"RCE_NAME": "ann/brain"}, tmp_path, tmp_path / "log")
    assert await asyncio.to_thread(first.child.wait) == 0
    order = json.loads(await asyncio.to_thread(out.read_text))
    assert order == {
        "variables": {"RCE_NAME": "ann/brain"},
        "directory": str(tmp_path),
        "output": str(tmp_path / "log"),
    }
    os.close(first.lock)
    await asyncio.sleep(0)
    while len(pool._waiting) < 2:  # noqa: ASYNC110  # a timer of the loop
        await asyncio.sleep(0)
    assert first.domain not in {each.domain for each in pool._waiting[:1]}


async def test_one_that_has_ended_is_passed_over(pool: Pool) -> None:
    dead, alive = pool._waiting
    dead.child.kill()
    await asyncio.to_thread(dead.child.wait)
    taken = pool.take()
    assert taken is alive
    taken.child.kill()
    taken.child.wait()
    os.close(taken.lock)


async def test_end_of_the_task_set_ends_those_that_wait(pool: Pool) -> None:
    children = [each.child for each in pool._waiting]
    pool.close()
    assert all(child.poll() is not None for child in children)
    assert pool.take() is None


async def test_one_that_does_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prepared, "COMMAND", (sys.executable, "-I", "-S", "-c", "import time; time.sleep(1000)"))
    monkeypatch.setattr(prepared, "END_TIMEOUT", 0.01)
    monkeypatch.setattr(domains, "_in_use", set)
    pool = Pool(1, Domains(tmp_path / "domains", range(1, 4)), {})
    pool.fill()
    (waiting,) = pool._waiting
    pool.close()
    assert waiting.child.poll() == -signal.SIGKILL


async def test_without_free_domains_fewer_wait(tmp_path: Path, pool: Pool) -> None:
    more = Pool(5, Domains(tmp_path / "domains", range(1, 4)), {})
    more.fill()
    assert len(more._waiting) == 1
    more.close()
