"""Bounded queue that keeps the newest items, read with `async for` or `get`."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator
from typing import Generic, TypeVar

from rce.errors import RceError, TimedOut, Unavailable

T = TypeVar("T")


class Stream(Generic[T]):
    """Queue of items in the order of their arrival.

    Read it with `async for`, which ends when the stream ends, or with `get`. Each item goes to one reader.

    Attributes:
        dropped: Number of items that were dropped because more than `depth` were unread; the oldest are dropped first.
    """

    def __init__(self, depth: int) -> None:
        """Create an empty stream that keeps `depth` unread items."""
        self.dropped = 0
        self._items: deque[T] = deque(maxlen=depth)
        self._changed = asyncio.Event()
        self._ended = False
        self._error: RceError | None = None

    def put(self, item: T) -> None:
        """Add an item, and drop the oldest one if there are too many. Ignored after `end`."""
        if self._ended:
            return
        self.dropped += len(self._items) == self._items.maxlen
        self._items.append(item)
        self._changed.set()

    def end(self, error: RceError | None = None) -> None:
        """End the stream: readers get the remaining items, then the end of the iteration or `error`.

        Args:
            error: Exception to raise in readers.
        """
        self._ended, self._error = True, self._error or error
        self._changed.set()

    async def get(self, timeout: float | None = None) -> T:  # noqa: ASYNC109  # as queues of other libraries
        """Return the next item, waiting for it if there is none.

        Args:
            timeout: Seconds to wait; None to wait without limit.

        Raises:
            TimedOut: Nothing arrived within `timeout` seconds.
            Unavailable: The stream has ended and all of its items have been read.
            RceError: The same, if it ended with an error.
        """
        try:
            async with asyncio.timeout(timeout):
                return await anext(self)
        except TimeoutError:
            raise TimedOut(f"nothing arrived within {timeout:g} s") from None
        except StopAsyncIteration:
            raise Unavailable("nothing more will arrive: the stream has been closed") from None

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
