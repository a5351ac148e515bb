"""Time turned by hand, for what waits without sockets."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, TypeVar

import pytest

T = TypeVar("T")


class HandTurnedLoop(asyncio.SelectorEventLoop):
    """An event loop whose time stands still until it is turned; it never waits."""

    def __init__(self) -> None:
        super().__init__()
        self._now = 0.0

    def time(self) -> float:
        return self._now

    def settle(self) -> None:
        """Run all that is ready, and all that becomes ready by that."""
        self.call_soon(lambda: None)
        while self._ready:
            self.call_soon(self.stop)
            self.run_forever()

    def turn(self, seconds: float) -> None:
        """Let time pass; what is due by the way runs at its time."""
        end = self._now + seconds
        self.settle()
        while self._scheduled and self._scheduled[0].when() <= end:
            self._now = max(self._now, self._scheduled[0].when())
            self.settle()
        self._now = end

    def begin(self, work: Coroutine[Any, Any, T]) -> asyncio.Task[T]:
        """Start a coroutine and run it until it waits for something."""
        task = self.create_task(work)
        self.settle()
        return task

    def do(self, work: Callable[[], T]) -> T:
        """Call a function inside the loop, and run what it has set off."""

        async def inside() -> T:
            return work()

        return self.begin(inside()).result()


@pytest.fixture
def hand() -> Iterator[HandTurnedLoop]:
    """A loop of its own for the test; fails when an exception was left for nobody."""
    loop = HandTurnedLoop()
    unhandled: list[dict[str, Any]] = []
    loop.set_exception_handler(lambda _, context: unhandled.append(context))
    yield loop
    for task in asyncio.all_tasks(loop):
        task.cancel()
    loop.settle()
    loop.close()
    assert not unhandled
