"""An event loop in a thread of its own, and how plain threads wait for what runs on it."""

from __future__ import annotations

import asyncio
import functools
import threading
from collections.abc import Callable, Coroutine, Iterator
from typing import Any, Concatenate, Final, Generic, ParamSpec, TypeVar

from rce.client.stream import Stream
from rce.errors import InvalidRequest, Unavailable

P = ParamSpec("P")
T = TypeVar("T")
W = TypeVar("W", covariant=True)


class LoopThread:
    """Runs from `start` to `stop`, once."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="rce client", daemon=True)

    @property
    def running(self) -> bool:
        return self._thread.is_alive()

    def start(self) -> None:
        if self._loop.is_closed():
            raise InvalidRequest("this robot has been opened before: make a new one")
        self._thread.start()

    def wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run it on the loop and return its result; raises Unavailable when there is none. Ctrl-C cancels it."""
        if not self.running:
            coroutine.close()
            raise Unavailable("the robot is not open")
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result()
        except BaseException:
            future.cancel()
            raise

    def call(self, function: Callable[[], T]) -> T:
        """Run a plain function on the loop."""

        async def run() -> T:
            return function()

        return self.wait(run())

    def stop(self) -> None:
        """End the loop and the thread."""
        if self.running:
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
            self._loop.close()


class Blocking(Generic[W]):
    """An object of the asyncio library (`inner`), used from plain threads."""

    def __init__(self, thread: LoopThread, inner: W) -> None:
        self._thread = thread
        self.inner: Final = inner


def blocking(
    method: Callable[Concatenate[W, P], Coroutine[Any, Any, T]],
) -> Callable[Concatenate[Blocking[W], P], T]:
    """The coroutine method of the inner object as a method that waits."""

    @functools.wraps(method)
    def call(self: Blocking[W], /, *arguments: P.args, **options: P.kwargs) -> T:
        return self._thread.wait(method(self.inner, *arguments, **options))

    return call


class BlockingStream(Blocking[Stream[T]]):
    """What arrives, in order: iterate over it, or `get` the next."""

    get = blocking(Stream[T].get)

    @property
    def dropped(self) -> int:
        return self.inner.dropped

    def __iter__(self) -> Iterator[T]:
        while True:
            found = self._thread.wait(_next(self.inner))
            if not found:
                return
            yield found[0]


async def _next(stream: Stream[T]) -> list[T]:
    async for item in stream:
        return [item]
    return []
