"""Crew: hands units of work to workers, and the unit of a worker that is lost to another one."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from itertools import count
from typing import Protocol, Self

from rce.errors import Died, NoCapacity, RceError, TimedOut, Unavailable
from rce.mapping.parallel.scan_arrays import count_scans
from rce.mapping.parallel.units import (
    Answer,
    Busy,
    ComparePlaces,
    Failed,
    FindOverlaps,
    KeepPart,
    MapPart,
    Mapped,
    MapSeed,
    Unit,
    Work,
    encode,
)

MAX_ATTEMPTS = 3  # of a unit: it may be the reason why its workers are lost
MAX_LOSSES = 5  # of a member's workers in a row, without an answer between
PAUSE = 1.0  # seconds before a lost worker is replaced; doubled with each loss in a row
PASSING = (Died, TimedOut, Unavailable, NoCapacity)  # errors after which another worker may succeed


class RemoteWorker(Protocol):
    """Worker as its crew sees it. `send` and `receive` raise one of PASSING if the worker is lost."""

    async def send(self, data: bytes) -> None:
        """Send an encoded unit."""

    async def receive(self) -> tuple[Answer, int]:
        """Wait for an answer; return it with its size in bytes."""

    async def close(self) -> None:
        """Dismiss the worker, which may be lost already; raise RceError if something of it may be left."""


@dataclass(frozen=True, slots=True)
class UnitRecord:
    """Cost of a unit.

    Attributes:
        phase: Number of the phase. A phase begins when units are asked for while none is waiting or at work; the units
            of a phase need nothing of each other.
        kind: Tag of the work.
        member: Number of the member of the crew.
        seconds: Elapsed seconds of the work.
        waited: Seconds from the first byte that was sent for it to its result.
        sent: Bytes to the worker, with the parts that it did not have.
        received: Bytes from the worker.
    """

    phase: int
    kind: str
    member: int
    seconds: float
    waited: float
    sent: int
    received: int


@dataclass(slots=True, eq=False)
class _Task:
    """Unit that waits or is at work."""

    work: Work
    is_needed: Callable[[], bool]
    phase: int
    result: asyncio.Future[bytes | None]
    attempts: int = 0


class _Lost(Exception):
    """The worker is lost; `error` says why."""

    def __init__(self, error: RceError) -> None:
        super().__init__(str(error))
        self.error = error


class Crew:
    """Members that execute units, each with one worker at a time. An asynchronous context manager.

    A member that cannot get a worker leaves; the crew fails when the last one has left.

    Attributes:
        records: Costs of the units that are done.
        lost: Number of workers that were lost.
    """

    def __init__(
        self,
        hire: Callable[[int], Awaitable[RemoteWorker]],
        size: int,
        on_scans: Callable[[int], None] = lambda scans: None,
        pause: Callable[[float], Awaitable[None]] = asyncio.sleep,
    ) -> None:
        """Make a crew.

        Args:
            hire: Returns a new worker for a member, given the member's number.
            size: Number of members.
            on_scans: Called with the number of scans that all units have mapped so far.
            pause: Waits for seconds.
        """
        self.records: list[UnitRecord] = []
        self.lost = 0
        self._hire, self._size, self._on_scans, self._pause = hire, size, on_scans, pause
        self._numbers = count()
        self._waiting: deque[_Task] = deque()
        self._parts: dict[int, bytes] = {}  # packed, by number
        self._scans: dict[_Task, int] = {}  # scans that are mapped
        self._wakeup = asyncio.Condition()
        self._members: list[asyncio.Task[None]] = []
        self._at_work: set[_Task] = set()
        self._open, self._phase = 0, 0  # units that somebody waits for; number of the current phase
        self._left: RceError | None = None  # reason of the last member that left
        self._kept: dict[int, RceError] = {}  # errors of workers that could not be dismissed, by member
        self._dismissed = False

    async def __aenter__(self) -> Self:
        """Begin to hire workers."""
        self._members = [asyncio.create_task(self._work(member)) for member in range(self._size)]
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Dismiss all workers.

        Raises:
            RceError: A worker could not be dismissed, and no other exception is under way.
        """
        self._dismissed = True
        for member in self._members:
            member.cancel()
        await asyncio.gather(*self._members, return_exceptions=True)
        if kind is None and self._kept:
            raise next(iter(self._kept.values()))

    async def run(self, work: Work, is_needed: Callable[[], bool] = lambda: True) -> bytes | None:
        """Have a unit executed.

        Args:
            work: What to do.
            is_needed: Asked when a worker is free; the unit is skipped if it returns False.

        Returns:
            The packed result, or None if the unit was skipped.

        Raises:
            RceError: The work cannot be done, or all members have left.
        """
        if not self._open:
            self._phase += 1
        task = _Task(work, is_needed, self._phase, asyncio.get_running_loop().create_future())
        self._open += 1
        try:
            await self._enqueue(task)
            return await task.result
        finally:
            self._open -= 1

    async def _enqueue(self, task: _Task, first: bool = False) -> None:
        if self._left is not None:
            raise self._left
        (self._waiting.appendleft if first else self._waiting.append)(task)
        async with self._wakeup:
            self._wakeup.notify()

    async def _work(self, member: int) -> None:
        """Execute units until the crew is dismissed, with one worker after the other."""
        losses = 0
        while True:
            before = len(self.records)
            try:
                await self._work_with(member, await self._hired(member))
            except _Lost as lost:
                if self._dismissed:
                    return
                losses = 1 if any(record.member == member for record in self.records[before:]) else losses + 1
                if losses >= MAX_LOSSES or not isinstance(lost.error, PASSING):
                    self._leave(member, lost.error)
                    return
            await self._pause(PAUSE * 2 ** (losses - 1))

    async def _hired(self, member: int) -> RemoteWorker:
        try:
            return await self._hire(member)
        except RceError as error:
            if self._dismissed:  # a worker that was cancelled while it was hired, and whose environment may be left
                self._kept[member] = error
            raise _Lost(error) from error

    async def _work_with(self, member: int, worker: RemoteWorker) -> None:
        """Execute units with a worker until it is lost."""
        known: set[int] = set()  # parts that the worker has
        try:
            while True:
                task = await self._next()
                if task.result.done():  # whoever waited for it was cancelled
                    continue
                if not task.is_needed():
                    _settle(task, None)
                    continue
                self._at_work.add(task)
                try:
                    await self._execute(member, worker, known, task)
                except RceError as error:
                    await self._retry(task, error)
                    self.lost += 1
                    raise _Lost(error) from error
                except Exception as error:  # a bug: nobody waits for ever
                    _settle(task, error)
                    raise
                finally:
                    self._at_work.discard(task)
        finally:
            await self._dismiss(member, worker)

    async def _dismiss(self, member: int, worker: RemoteWorker) -> None:
        try:
            await worker.close()
        except RceError as error:
            self._kept[member] = error
        else:
            self._kept.pop(member, None)

    async def _next(self) -> _Task:
        async with self._wakeup:
            await self._wakeup.wait_for(lambda: self._waiting)
            return self._waiting.popleft()

    async def _execute(self, member: int, worker: RemoteWorker, known: set[int], task: _Task) -> None:
        """Execute a unit, after the worker has the parts that it needs.

        Raises:
            RceError: The worker is lost.
        """
        loop, work = asyncio.get_running_loop(), task.work
        began, sent, received = loop.time(), 0, 0
        task.attempts += 1
        missing = [part for part in _parts_of(work) if part not in known]
        done = Mapped(b"", 0.0)
        for each in (*(KeepPart(part, self._parts[part]) for part in missing), work):
            unit = Unit(next(self._numbers), each)  # numbers grow: a worker takes a lower one for a repetition
            data = encode(unit)
            await worker.send(data)
            result, size = await self._receive(worker, unit.number, task)
            if isinstance(result, Failed):
                _settle(task, RceError.from_info(result.error))
                return
            done, sent, received = result, sent + len(data), received + size
        known.update(missing)
        if isinstance(work, MapPart | MapSeed):
            self._report(task, count_scans(work.scans))
        if isinstance(work, MapPart):
            known.add(work.part)
            self._parts[work.part] = done.state
        kind = str(type(work).__struct_config__.tag)
        self.records.append(UnitRecord(task.phase, kind, member, done.seconds, loop.time() - began, sent, received))
        _settle(task, done.state)

    async def _receive(self, worker: RemoteWorker, number: int, task: _Task) -> tuple[Mapped | Failed, int]:
        """Wait for the result of a unit of this number, which belongs to a task."""
        while True:
            answer, size = await worker.receive()
            if answer.number != number:
                continue  # of a unit that was given up
            if not isinstance(answer.result, Busy):
                return answer.result, size
            self._report(task, answer.result.scans)

    def _report(self, task: _Task, scans: int) -> None:
        """Report that a task has mapped this many scans."""
        self._scans[task] = scans
        self._on_scans(sum(self._scans.values()))

    async def _retry(self, task: _Task, error: RceError) -> None:
        self._scans.pop(task, None)
        if task.attempts < MAX_ATTEMPTS and isinstance(error, PASSING):
            await self._enqueue(task, first=True)
        else:
            _settle(task, error)

    def _leave(self, member: int, error: RceError) -> None:
        """Remove a member; if it is the last one, all waiting units fail."""
        self._members[member].set_name("left")
        if all(each.get_name() == "left" for each in self._members):
            self._left = error
            for task in (*self._waiting, *self._at_work):
                _settle(task, error)
            self._waiting.clear()


def _settle(task: _Task, result: bytes | Exception | None) -> None:
    if task.result.done():
        return
    if isinstance(result, Exception):
        task.result.set_exception(result)
    else:
        task.result.set_result(result)


def _parts_of(work: Work) -> list[int]:
    """Return the numbers of the parts that a worker needs for a unit."""
    match work:
        case FindOverlaps(own, other):
            return [own, other]
        case ComparePlaces(parts=parts):
            return parts
        case _:
            return []
