"""Queries: one worker for each user, with the graphs that this user may read and no others."""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from typing import Protocol

from msgspec import Struct

from rce.api.knowledge import QueryResult
from rce.errors import LimitExceeded
from rce.knowledge.messages import Answered, Command, Drop, Evaluate, Load
from rce.knowledge.records import Reader
from rce.knowledge.worker import PROGRAM, Worker
from rce.process.metrics import Timing

LOAD_TOGETHER = 200  # graphs that are fetched from the database at once

_seconds = Timing("rce_knowledge_query_seconds", "Time of queries, from their turn to their answer")


class QueryLimits(Struct, frozen=True):
    """Limits of queries.

    Attributes:
        seconds: Time of one query.
        memory: Bytes that one query may allocate.
        rows: Rows of an answer.
        workers: Number of processes, and so of users whose queries run at once.
        waiting: Queries of one user, with the one that runs.
    """

    seconds: float = 10.0
    memory: int = 512 * 1024**2
    rows: int = 10_000
    workers: int = 4
    waiting: int = 16


class Graphs(Protocol):
    """The graphs of the repository."""

    async def stamps(self, reader: Reader) -> dict[str, int]:
        """Return the named graphs that a reader may read, each with a number that changes with its content."""

    async def triples(self, graphs: Sequence[str]) -> dict[str, bytes]:
        """Return the content of graphs, as N-Triples; those that are gone are missing."""


class Queries:
    """Answers queries of many users."""

    def __init__(
        self, graphs: Graphs, limits: QueryLimits, make: Callable[[], Worker] = lambda: Worker(PROGRAM)
    ) -> None:
        """Start nothing yet; `make` makes a worker."""
        self._graphs = graphs
        self._limits = limits
        self._make = make
        self._workers: OrderedDict[Reader, Worker] = OrderedDict()  # by reader; the one used last comes last
        self._locks: dict[Reader, asyncio.Lock] = {}
        self._waiting: dict[Reader, int] = {}
        self._busy: set[Reader] = set()
        self._free = asyncio.Semaphore(limits.workers)

    async def run(self, reader: Reader, query: str) -> QueryResult:
        """Answer a SPARQL query over what a reader may read.

        Raises:
            LimitExceeded: Too many queries of this reader wait, or this one needs too much memory or has too many rows.
            TimedOut: It takes too long.
            InvalidRequest: It is malformed, or not allowed.
        """
        async with self._turn(reader) as worker:
            began = time.perf_counter()
            stamps = await self._graphs.stamps(reader)
            changed = [graph for graph, stamp in stamps.items() if worker.loaded.get(graph) != stamp]
            gone = worker.loaded.keys() - stamps.keys()
            if changed or gone:
                await worker.send(self._commands(gone, changed))
                worker.loaded = stamps
            limits = self._limits
            try:
                answer = await worker.ask(Evaluate(query, limits.seconds, limits.memory, limits.rows))
            finally:
                _seconds.labels().observe_since(began)
            assert isinstance(answer, Answered)
            return answer.result

    async def _commands(self, gone: set[str], changed: list[str]) -> AsyncIterator[Command]:
        for graph in gone:
            yield Drop(graph)
        for start in range(0, len(changed), LOAD_TOGETHER):
            for graph, triples in (await self._graphs.triples(changed[start : start + LOAD_TOGETHER])).items():
                yield Load(graph, triples)

    @asynccontextmanager
    async def _turn(self, reader: Reader) -> AsyncIterator[Worker]:
        """Wait for the reader's turn and for a worker; queries of one reader run one after another."""
        if self._waiting.get(reader, 0) >= self._limits.waiting:
            raise LimitExceeded(f"{self._limits.waiting} of your queries wait already", limit=self._limits.waiting)
        self._waiting[reader] = self._waiting.get(reader, 0) + 1
        try:
            async with self._locks.setdefault(reader, asyncio.Lock()), self._free:
                self._busy.add(reader)
                try:
                    yield await self._worker(reader)
                finally:
                    self._busy.discard(reader)
        finally:
            self._waiting[reader] -= 1
            if not self._waiting[reader]:
                del self._waiting[reader], self._locks[reader]

    async def _worker(self, reader: Reader) -> Worker:
        """Return the worker of a reader; the one that has been idle longest makes room for a new one."""
        if reader not in self._workers:
            idle = [each for each in self._workers if each not in self._busy]
            old = self._workers.pop(idle[0]) if len(self._workers) >= self._limits.workers and idle else None
            self._workers[reader] = self._make()
            if old is not None:
                await old.stop()
        self._workers.move_to_end(reader)
        return self._workers[reader]

    async def stop(self) -> None:
        """Kill all workers."""
        while self._workers:
            await self._workers.popitem()[1].stop()
