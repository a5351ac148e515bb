"""An event loop whose time is turned by hand."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


class HandTurnedLoop(asyncio.SelectorEventLoop):
    """Event loop whose time stands still until `turn`; it never waits."""

    _ready: deque[asyncio.Handle]  # of asyncio.BaseEventLoop
    _scheduled: list[asyncio.TimerHandle]  # as above, a heap

    def __init__(self) -> None:
        super().__init__()
        self._now = 0.0

    def time(self) -> float:
        return self._now

    def settle(self) -> None:
        """Run callbacks until none is ready."""
        self.call_soon(lambda: None)
        while self._ready:
            self.call_soon(self.stop)
            self.run_forever()

    def turn(self, seconds: float) -> None:
        """Let time pass; timers run at their times."""
        end = self._now + seconds
        self.settle()
        while self._scheduled and self._scheduled[0].when() <= end:
            self._now = max(self._now, self._scheduled[0].when())
            self.settle()
        self._now = end

    def begin(self, work: Coroutine[Any, Any, T]) -> asyncio.Task[T]:
        """Start a coroutine and run it until it waits."""
        task = self.create_task(work)
        self.settle()
        return task

    def do(self, work: Callable[[], T]) -> T:
        """Call a function inside the loop, and run what it started."""

        async def inside() -> T:
            return work()

        return self.begin(inside()).result()
