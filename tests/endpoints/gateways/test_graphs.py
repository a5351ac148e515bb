"""ROS graphs of environments, shared by all clients of gateways."""

from __future__ import annotations

import asyncio
import time
from typing import Any, cast

import pytest

from endpoints.gateways.graphs import Graphs
from rce.control.calls.watching import RosGraph
from rce.control.client import ControlClient
from rce.errors import NotFound


class Master:
    def __init__(self) -> None:
        self.asked: list[Any] = []
        self.fails = False

    async def call(self, call: Any) -> RosGraph:
        self.asked.append(call)
        await asyncio.sleep(0)
        if self.fails:
            raise NotFound("no such environment")
        return RosGraph([], [])


async def test_environment_is_asked_once_for_all_its_clients() -> None:
    master, graphs = Master(), Graphs()
    control = cast(ControlClient, master)
    await asyncio.gather(*(graphs.read(control, f"ann/@rosbridge_{n}", "brain") for n in range(5)))
    await graphs.read(control, "ann/@rosbridge_9", "brain", 0.0)
    assert len(master.asked) == 1
    await graphs.read(control, "bob/@rosbridge_9", "brain", 0.0)
    assert len(master.asked) == 2, "an environment of another user"


async def test_rights_are_checked_for_each_client() -> None:
    master, graphs = Master(), Graphs()
    await graphs.read(cast(ControlClient, master), "ann/@rosbridge_1", "brain")
    master.fails = True
    with pytest.raises(NotFound):
        await graphs.check(cast(ControlClient, master), "ann/@rosbridge_2", "brain")


async def test_answer_that_was_asked_for_before_a_change_is_not_good_enough() -> None:
    master, graphs = Master(), Graphs()
    control = cast(ControlClient, master)
    early = asyncio.create_task(graphs.read(control, "ann/@rosbridge_1", "brain"))
    while not master.asked:  # noqa: ASYNC110  # a turn of the loop or two
        await asyncio.sleep(0)
    changed = time.monotonic()
    await asyncio.gather(*(graphs.read(control, f"ann/@rosbridge_{n}", "brain", changed) for n in range(5)))
    await early
    assert len(master.asked) == 2, "once more for all who have seen the change"
