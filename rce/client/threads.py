"""Event loop in a background thread, and wrappers through which plain threads use its objects."""

from __future__ import annotations

import asyncio
import functools
import threading
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import CancelledError
from typing import Any, Concatenate, Final, Generic, ParamSpec, TypeVar

from rce.client.stream import Stream
from rce.errors import InvalidRequest, Unavailable

P = ParamSpec("P")
T = TypeVar("T")
W = TypeVar("W", covariant=True)


class LoopThread:
    """Event loop in a daemon thread, which runs once, from `start` to `stop`."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="rce client", daemon=True)
        self._lock = threading.Lock()  # so that nothing is submitted to the loop after its end
        self._running = False

    @property
    def running(self) -> bool:
        """True between `start` and `stop`."""
        return self._running

    def start(self) -> None:
        """Start the thread; raises InvalidRequest if it has run before."""
        with self._lock:
            if self._thread.ident is not None:
                raise InvalidRequest("this robot has been opened before: make a new one")
            self._running = True
            self._thread.start()

    def wait(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run a coroutine on the loop and return its result. An interrupt (Ctrl-C) cancels it.

        Raises:
            Unavailable: The loop is not running, or was stopped before the coroutine ended.
        """
        with self._lock:
            if not self._running:
                coroutine.close()
                raise Unavailable("the robot is not open")
            future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result()
        except CancelledError:
            raise Unavailable("the robot has been closed") from None
        except BaseException:
            future.cancel()
            raise

    def call(self, function: Callable[[], T]) -> T:
        """Run a plain function on the loop and return its result."""

        async def run() -> T:
            return function()

        return self.wait(run())

    def stop(self) -> None:
        """Stop the loop and wait for the thread to end; coroutines that still run on it are cancelled."""
        with self._lock:
            if not self._running:
                return
            self._running = False
            self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self) -> None:
        self._loop.run_forever()
        self._loop.run_until_complete(_cancel_others())
        self._loop.close()


async def _cancel_others() -> None:
    """Cancel all other tasks of the loop and wait until they have ended."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


class Blocking(Generic[W]):
    """Blocking face of an object of the asyncio client.

    Attributes:
        inner: The asyncio object, which must be used on its own event loop only.
    """

    def __init__(self, thread: LoopThread, inner: W) -> None:
        self._thread = thread
        self.inner: Final = inner


def blocking(
    method: Callable[Concatenate[W, P], Coroutine[Any, Any, T]],
) -> Callable[Concatenate[Blocking[W], P], T]:
    """Turn a coroutine method of the inner object into a method that blocks; its signature and docstring are kept."""

    @functools.wraps(method)
    def call(self: Blocking[W], /, *arguments: P.args, **options: P.kwargs) -> T:
        return self._thread.wait(method(self.inner, *arguments, **options))

    return call


class BlockingStream(Blocking[Stream[T]]):
    """Blocking `Stream`: iterate over it, or `get` the next item."""

    get = blocking(Stream[T].get)
    """Return the next item, waiting for it if there is none; see `Stream.get`."""

    @property
    def dropped(self) -> int:
        """Number of items that were dropped because too many were unread."""
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
