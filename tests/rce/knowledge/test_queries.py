"""Queries of many users, with workers that a test controls."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterable, Callable, Sequence

import pytest

from rce.api.knowledge import QueryResult
from rce.errors import LimitExceeded
from rce.knowledge.messages import Answered, Command, Drop, Evaluate, Load, Read, Reply
from rce.knowledge.queries import Queries, QueryLimits
from rce.knowledge.records import Reader
from rce.knowledge.worker import Worker

ANN, BOB, EVE = Reader("ann"), Reader("bob"), Reader("eve")


class FakeGraphs:
    def __init__(self) -> None:
        self.readable = {"ann": {"a": 1, "b": 1}, "bob": {"b": 1}, "eve": dict[str, int]()}

    async def stamps(self, reader: Reader) -> dict[str, int]:
        return dict(self.readable[reader.user])

    async def triples(self, graphs: Sequence[str]) -> dict[str, bytes]:
        return dict.fromkeys(graphs, b"")


class FakeWorker(Worker):
    def __init__(self) -> None:
        super().__init__()
        self.commands: list[Command] = []
        self.go = asyncio.Event()
        self.stopped = False

    async def send(self, commands: AsyncIterable[Command]) -> None:
        self.commands += [each async for each in commands]

    async def ask(self, work: Read | Evaluate) -> Reply:
        await self.go.wait()
        return Answered(QueryResult(answer=True))

    async def stop(self) -> None:
        self.stopped = True


class Pool:
    def __init__(self, **limits: int) -> None:
        self.graphs = FakeGraphs()
        self.workers: list[FakeWorker] = []
        self.queries = Queries(self.graphs, QueryLimits(**limits), self.make)

    def make(self) -> Worker:
        self.workers.append(FakeWorker())
        return self.workers[-1]


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(30):
        while not condition():  # noqa: ASYNC110  # the loop has only what the test started
            await asyncio.sleep(0)


async def test_worker_gets_what_its_user_may_read_and_later_the_changes() -> None:
    pool = Pool()
    running = asyncio.create_task(pool.queries.run(ANN, "ASK {}"))
    await until(lambda: pool.workers)
    pool.workers[0].go.set()
    assert (await running).answer is True
    assert pool.workers[0].commands == [Load("a", b""), Load("b", b"")]
    pool.workers[0].commands.clear()
    await pool.queries.run(ANN, "ASK {}")
    assert pool.workers[0].commands == []
    pool.graphs.readable["ann"] = {"b": 2}
    await pool.queries.run(ANN, "ASK {}")
    assert pool.workers[0].commands == [Drop("a"), Load("b", b"")]
    await pool.queries.stop()
    assert pool.workers[0].stopped


async def test_worker_that_was_idle_longest_makes_room() -> None:
    pool = Pool(workers=2)
    for reader in (ANN, BOB, ANN, EVE):
        running = asyncio.create_task(pool.queries.run(reader, "ASK {}"))
        await until(lambda: pool.workers)
        while not running.done():
            for each in pool.workers:
                each.go.set()
            await asyncio.sleep(0)
    assert [worker.stopped for worker in pool.workers] == [False, True, False]


async def test_queries_of_one_user_wait_for_each_other_and_not_for_those_of_others() -> None:
    pool = Pool(workers=2, waiting=2)
    first, second = (asyncio.create_task(pool.queries.run(ANN, "ASK {}")) for _ in range(2))
    other = asyncio.create_task(pool.queries.run(BOB, "ASK {}"))
    await until(lambda: len(pool.workers) == 2)
    with pytest.raises(LimitExceeded, match="2 of your queries wait"):
        await pool.queries.run(ANN, "ASK {}")
    for worker in pool.workers:
        worker.go.set()
    assert all([(await each).answer for each in (first, second, other)])
    assert len(pool.workers) == 2
