"""A worker and its process."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator

import pytest

from rce.errors import TimedOut, Unavailable
from rce.knowledge import worker as module
from rce.knowledge.messages import Answered, Command, Document, Evaluate, Load, Read, Readings
from rce.knowledge.worker import Worker
from tests.support.knowledge import CUP

MEMORY = 512 * 1024**2
ENDLESS = "SELECT (COUNT(*) AS ?n) { " + " ".join(f"?a{n} ?b{n} ?c{n} ." for n in range(12)) + " }"


async def some(*commands: Command) -> AsyncIterator[Command]:
    for each in commands:
        yield each


async def test_endless_query_ends_after_its_limit_and_the_worker_lives() -> None:
    worker = Worker()
    read = await worker.ask(Read([Document("http://a", CUP)], 60, MEMORY))
    assert isinstance(read, Readings)
    await worker.send(some(*(Load(f"http://a/{number}", read.results[0].triples) for number in range(3))))
    worker.loaded = {"http://a": 1}
    with pytest.raises(TimedOut, match=r"stopped after 0\.5 s"):
        await worker.ask(Evaluate(ENDLESS, 0.5, MEMORY, 10))
    answer = await worker.ask(Evaluate("ASK { ?s a ?c }", 60, MEMORY, 10))
    assert isinstance(answer, Answered)
    assert answer.result.answer is True
    assert worker.loaded
    await worker.stop()
    assert not worker.loaded


async def test_process_that_dies_is_started_again() -> None:
    worker = Worker((sys.executable, "-c", "raise SystemExit(1)"))
    worker.loaded = {"http://a": 1}
    with pytest.raises(Unavailable, match="has died"):
        await worker.ask(Read([], 10, MEMORY))
    assert not worker.loaded
    worker._program = module.PROGRAM
    assert await worker.ask(Read([], 60, MEMORY)) == Readings([])
    await worker.stop()


async def test_process_that_says_nothing_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MARGIN", 0.1)
    worker = Worker((sys.executable, "-c", "import time; time.sleep(1000)"))
    with pytest.raises(TimedOut, match="no answer"):
        await worker.ask(Read([], 0.1, MEMORY))
    assert worker._process is None
