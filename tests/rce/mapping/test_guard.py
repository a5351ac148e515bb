from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rce.client import Environment, Event, Reconnected, Robot, Stream
from rce.errors import Died, TimedOut, Unavailable
from rce.mapping.guard import NodeGuard
from rce.protocol.messages import EnvironmentEvent, NodeEvent


class Watched:
    def __init__(self) -> None:
        self.stream: Stream[Event] = Stream(10)
        self.reconnections = asyncio.Event()
        robot, environment = SimpleNamespace(events=lambda: self.stream), SimpleNamespace(tag="brain")
        self.guard = NodeGuard(cast(Robot, robot), cast(Environment, environment), "mapper", self._on_reconnected)

    async def _on_reconnected(self) -> None:
        self.reconnections.set()


async def never() -> None:
    await asyncio.Event().wait()


async def test_result_of_the_work_is_returned() -> None:
    async def work() -> int:
        return 7

    async with Watched().guard as guard:
        assert await guard.wait(work(), 30.0, "a number") == 7


@pytest.mark.parametrize(
    ("event", "reason"),
    [
        (NodeEvent("brain", "mapper", 3, ["no memory"]), "status 3\nno memory"),
        (EnvironmentEvent("brain", "lost", "its machine is away"), "its machine is away"),
    ],
)
async def test_end_of_the_node_ends_the_wait(event: Any, reason: str) -> None:
    watched = Watched()
    async with watched.guard as guard:
        watched.stream.put(NodeEvent("brain", "another", 3, []))
        watched.stream.put(event)
        with pytest.raises(Died, match=reason):
            await guard.wait(never(), 30.0, "nothing")


async def test_wait_is_bounded() -> None:
    async with Watched().guard as guard:
        with pytest.raises(TimedOut, match="waiting for nothing"):
            await guard.wait(never(), 0.01, "nothing")


async def test_closed_robot_ends_the_wait() -> None:
    watched = Watched()
    async with watched.guard as guard:
        watched.stream.end(None)
        with pytest.raises(Unavailable, match="was closed"):
            await guard.wait(never(), 30.0, "nothing")


async def test_reconnection_is_reported() -> None:
    watched = Watched()
    async with watched.guard:
        watched.stream.put(Reconnected(True))
        await asyncio.wait_for(watched.reconnections.wait(), 30.0)
