"""A bounded queue that keeps the newest, read with `async for` or `get`."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from typing import Generic, TypeVar

from rce.errors import RceError, TimedOut, Unavailable

T = TypeVar("T")


class Stream(Generic[T]):
    """What arrives, in order; the oldest is dropped when more than `depth` wait, and counted in `dropped`."""

    def __init__(self, depth: int) -> None:
        self.dropped = 0
        self._items: deque[T] = deque(maxlen=depth)
        self._changed = asyncio.Event()
        self._ended = False
        self._error: RceError | None = None

    def put(self, item: T) -> None:
        """Add the newest."""
        if self._ended:
            return
        self.dropped += len(self._items) == self._items.maxlen
        self._items.append(item)
        self._changed.set()

    def end(self, error: RceError | None = None) -> None:
        """No more will come; readers take what is there, and then get `error` or the end of the iteration."""
        self._ended, self._error = True, self._error or error
        self._changed.set()

    async def get(self, timeout: float | None = None) -> T:  # noqa: ASYNC109  # as queues of other libraries
        """The next item. Raises TimedOut after `timeout` seconds, Unavailable (or why it ended) after the end."""
        try:
            async with asyncio.timeout(timeout):
                return await anext(self)
        except TimeoutError:
            raise TimedOut(f"nothing arrived within {timeout:g} s") from None
        except StopAsyncIteration:
            raise Unavailable("nothing more will arrive: this has been closed") from None

    def __aiter__(self) -> AsyncIterator[T]:
        return self

    async def __anext__(self) -> T:
        while not self._items:
            if self._ended:
                if self._error is not None:
                    raise self._error
                raise StopAsyncIteration
            self._changed.clear()
            await self._changed.wait()
        return self._items.popleft()
