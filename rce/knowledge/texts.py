"""Reading of OWL texts in a worker, one request after another, and one of each user in turn."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from weakref import WeakValueDictionary

from rce.errors import RceError
from rce.knowledge.messages import Document, Read, Reading, Readings
from rce.knowledge.worker import Worker

SECONDS = 30.0  # for one request
MEMORY = 1024 * 1024**2


class Texts:
    """Reads texts."""

    def __init__(self, make: Callable[[], Worker] = Worker) -> None:
        """Start nothing yet; `make` makes a worker."""
        self._worker = make()
        self._turn = asyncio.Lock()  # in the order in which users ask
        self._turns: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()  # of a user's own requests

    async def read(self, user: str, base: str, text: str) -> Reading:
        """Read a text of a user; relative IRIs in it refer to `base`.

        Raises:
            InvalidRequest: It is malformed, or has more than it may.
            TimedOut: It takes too long.
            LimitExceeded: It needs too much memory.
        """
        if not text.strip():
            return Reading()
        reading = (await self.read_all(user, [Document(base, text)]))[0]
        if reading.refused is not None:
            raise RceError.from_info(reading.refused)
        return reading

    async def read_all(self, user: str, documents: Sequence[Document]) -> list[Reading]:
        """Read texts of a user; what is wrong with one is in its reading.

        Raises:
            TimedOut: All together take too long.
            LimitExceeded: They need too much memory.
        """
        async with self._turns.setdefault(user, asyncio.Lock()), self._turn:
            answer = await self._worker.ask(Read(list(documents), SECONDS, MEMORY))
        assert isinstance(answer, Readings)
        return answer.results

    async def stop(self) -> None:
        """Kill the worker."""
        await self._worker.stop()
