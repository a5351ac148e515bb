"""Robot of the benchmark of bad networks."""

from __future__ import annotations

import asyncio
import time

from rce.bench.network.robot import DOWN, UP, ticks
from rce.bench.network.streams import STREAMS


async def test_ticks_end_in_time_and_late_ones_are_left_out() -> None:
    began = time.monotonic()
    count = 0
    async for _ in ticks(0.001, began + 0.05):
        count += 1
        if count == 1:
            await asyncio.sleep(0.03)
    assert 1 < count <= 50
    assert time.monotonic() >= began + 0.049


def test_each_stream_has_a_sender() -> None:
    assert {stream.name for stream in (*UP, *DOWN)} == {stream.name for stream in STREAMS}
