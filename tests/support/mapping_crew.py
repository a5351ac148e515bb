"""Workers of parallel mapping in this process, which a test may lose."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rce.errors import Died, RceError
from rce.mapping.parallel.units import Answer, Busy, Unit, decode_unit, encode
from rce.mapping.parallel.worker import Worker

Fault = Callable[[Unit], RceError | None]


class LocalWorker:
    """Worker in a thread; `fault` may return the error with which it is lost when it gets a unit."""

    def __init__(self, fault: Fault = lambda unit: None) -> None:
        self.units: list[Unit] = []
        self.closed = False
        self.at_work = asyncio.Event()
        self._worker, self._fault = Worker(), fault
        self._answers: asyncio.Queue[Answer | RceError] = asyncio.Queue()

    async def send(self, data: bytes) -> None:
        unit = decode_unit(data)
        self.units.append(unit)
        self.at_work.set()
        lost = self._fault(unit)
        if lost is not None:
            self._answers.put_nowait(lost)
            return
        self._answers.put_nowait(Answer(unit.number, Busy(1)))
        self._answers.put_nowait(await asyncio.to_thread(self._worker.execute, unit))

    async def receive(self) -> tuple[Answer, int]:
        answer = await self._answers.get()
        if isinstance(answer, RceError):
            raise answer
        return answer, len(encode(answer))

    async def close(self) -> None:
        self.closed = True


class LocalCrew:
    """Hires workers in this process. Worker number n (from 0, in order of hiring) has the fault `faults[n]`."""

    def __init__(self, faults: dict[int, Fault] | None = None) -> None:
        self.workers: list[LocalWorker] = []
        self.hired = asyncio.Event()
        self._faults = faults or {}

    async def hire(self, member: int) -> LocalWorker:
        worker = LocalWorker(self._faults.get(len(self.workers), lambda unit: None))
        self.workers.append(worker)
        self.hired.set()
        return worker


def dies(unit: Unit) -> RceError | None:
    """Return the error of a worker that dies with any unit."""
    return Died("killed")
