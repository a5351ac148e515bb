"""Changes of an environment that a client has begun: operations take effect in the order in which it sends them."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

LIMIT = 3.0  # seconds; what takes longer, as in an environment that is starting, is not waited for


class Changes:
    """Changes that are under way.

    Attributes:
        last: Monotonic time at which the last one was carried out.
    """

    def __init__(self) -> None:
        self.last = -math.inf
        self._under_way: set[asyncio.Future[None]] = set()

    def begin(self, change: asyncio.Future[None]) -> None:
        """Add a change, which is carried out when the future is done."""
        self._under_way.add(change)
        change.add_done_callback(self._end)

    def _end(self, change: asyncio.Future[None]) -> None:
        self._under_way.discard(change)
        self.last = time.monotonic()

    @asynccontextmanager
    async def carry_out(self) -> AsyncIterator[None]:
        """Carry out a change in the block, which begins when those that are under way now are over."""
        earlier, change = tuple(self._under_way), asyncio.get_running_loop().create_future()
        self.begin(change)
        try:
            if earlier:
                await asyncio.wait(earlier, timeout=LIMIT)
            yield
        finally:
            change.set_result(None)

    async def settle(self) -> None:
        """Wait until all changes that are under way now are carried out, for a limited time."""
        if self._under_way:
            await asyncio.wait(tuple(self._under_way), timeout=LIMIT)
