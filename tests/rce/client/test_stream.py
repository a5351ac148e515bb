"""Bounded streams."""

from __future__ import annotations

import pytest

from rce.client import Stream
from rce.errors import Forbidden, TimedOut, Unavailable


async def test_oldest_items_are_dropped_and_counted() -> None:
    stream: Stream[int] = Stream(2)
    for number in range(5):
        stream.put(number)
    assert stream.dropped == 3
    assert [await stream.get(1), await stream.get(1)] == [3, 4]


async def test_remaining_items_are_read_before_the_end() -> None:
    stream: Stream[int] = Stream(10)
    stream.put(1)
    stream.end()
    stream.put(2)
    assert [item async for item in stream] == [1]
    with pytest.raises(Unavailable):
        await stream.get(1)


async def test_first_error_ends_the_stream() -> None:
    stream: Stream[int] = Stream(10)
    stream.end(Forbidden("revoked"))
    stream.end(Unavailable("closed"))
    for _ in range(2):
        with pytest.raises(Forbidden):
            await stream.get(1)


async def test_get_times_out() -> None:
    with pytest.raises(TimedOut, match=r"0\.01 s"):
        await Stream[int](1).get(0.01)
