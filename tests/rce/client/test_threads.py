"""Event loop in a thread, and objects of the asyncio client that plain threads use."""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from rce.client.stream import Stream
from rce.client.threads import Blocking, BlockingStream, LoopThread, blocking
from rce.errors import InvalidRequest, NotFound, Unavailable


@pytest.fixture
def thread() -> Iterator[LoopThread]:
    thread = LoopThread()
    thread.start()
    yield thread
    thread.stop()


class Counter:
    """Object of the asyncio client."""

    def __init__(self) -> None:
        self.value = 0

    async def add(self, number: int, *, times: int = 1) -> int:
        """Add a number."""
        if number < 0:
            raise NotFound("there are no negative numbers")
        self.value += number * times
        return self.value


class BlockingCounter(Blocking[Counter]):
    add = blocking(Counter.add)


def test_coroutine_method_blocks_and_keeps_signature_and_docstring(thread: LoopThread) -> None:
    counter = BlockingCounter(thread, Counter())
    assert counter.add(2) == 2
    assert counter.add(3, times=2) == 8
    with pytest.raises(NotFound):
        counter.add(-1)
    assert inspect.signature(BlockingCounter.add) == inspect.signature(Counter.add)
    assert BlockingCounter.add.__doc__ == "Add a number."


def test_plain_function_runs_on_the_loop(thread: LoopThread) -> None:
    assert thread.call(lambda: threading.current_thread().name) == "rce client"


def test_loop_runs_once() -> None:
    thread = LoopThread()
    with pytest.raises(Unavailable, match="not open"):
        thread.call(lambda: None)
    assert not thread.running
    thread.start()
    assert thread.running
    with pytest.raises(InvalidRequest, match="opened before"):
        thread.start()
    thread.stop()
    thread.stop()
    assert not thread.running
    with pytest.raises(Unavailable, match="not open"):
        thread.call(lambda: None)
    with pytest.raises(InvalidRequest, match="opened before"):
        thread.start()


def test_stop_ends_calls_of_other_threads() -> None:
    thread = LoopThread()
    thread.start()
    begun = threading.Event()
    ended: list[str] = []

    async def hang() -> None:
        begun.set()
        try:
            await asyncio.Event().wait()
        finally:
            ended.append("cleaned up")

    with ThreadPoolExecutor(1) as pool:
        call = pool.submit(lambda: thread.wait(hang()))
        assert begun.wait(20)
        thread.stop()
        with pytest.raises(Unavailable, match="closed"):
            call.result(20)
    assert ended == ["cleaned up"]


def test_call_that_is_submitted_while_the_loop_stops_ends() -> None:
    thread = LoopThread()
    thread.start()
    entered, leave = threading.Event(), threading.Event()

    def block() -> None:
        entered.set()
        leave.wait(20)

    with ThreadPoolExecutor(3) as pool:
        first = pool.submit(thread.call, block)
        assert entered.wait(20)
        late = pool.submit(thread.call, lambda: "late")
        stop = pool.submit(thread.stop)
        leave.set()
        stop.result(20)
        first.exception(20)
        error = late.exception(20)
        assert error is None or isinstance(error, Unavailable)


def test_stream_is_iterated_until_its_end(thread: LoopThread) -> None:
    stream: Stream[int] = thread.call(lambda: Stream(2))
    blocking_stream = BlockingStream(thread, stream)

    def fill() -> None:
        for number in range(3):
            stream.put(number)
        stream.end()

    thread.call(fill)
    assert blocking_stream.dropped == 1
    assert list(blocking_stream) == [1, 2]
    with pytest.raises(Unavailable):
        blocking_stream.get(20)


def test_error_of_a_stream_is_raised_by_its_iteration(thread: LoopThread) -> None:
    stream: Stream[int] = thread.call(lambda: Stream(2))
    thread.call(lambda: stream.end(NotFound("gone")))
    with pytest.raises(NotFound, match="gone"):
        list(BlockingStream(thread, stream))
