"""Processes of a Robot endpoint share a port: robots are divided among them, and survive the end of one."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from rce.api.client import ApiClient
from rce.client import Robot
from tests.support.e2e.real_platform import USER, RealPlatform, until

BOTH = {"robot-1", "robot-1.2"}
MOST = 64  # the kernel gives each robot to one of the processes by chance, so robots come until each has one
STRING = "std_msgs/String"


@pytest.fixture
async def shared(tmp_path: Path) -> AsyncIterator[RealPlatform]:
    async with RealPlatform(tmp_path, "--robot-processes", "2") as platform:
        yield platform


def _endpoints(url: str) -> set[str]:
    """Return the endpoint processes that have robots."""
    robots = ApiClient(url, user=USER, password=USER).items(dict[str, Any], "robots")
    return {robot["endpoint"] for robot in robots}


async def pass_around(robots: list[Robot], tag: str) -> list[str]:
    """Let each robot send its number to the next one."""
    ears = [await robot.subscriber(f"in_{tag}", STRING) for robot in robots]
    for number, robot in enumerate(robots):
        mouth = await robot.publisher(f"out_{tag}", STRING, to=f"r{(number + 1) % len(robots)}/in_{tag}")
        await mouth.publish({"data": str(number)})
    return [(await asyncio.wait_for(ear.get(), 60))["data"] for ear in ears]


async def test_robots_are_divided_and_survive_the_end_of_a_process(shared: RealPlatform) -> None:
    second = r"endpoints\.robot .*--share-port"
    await until(lambda: shared.pid(second))
    await until(lambda: "robot-1.2 joined" in shared.log)
    async with AsyncExitStack() as stack:
        robots: list[Robot] = []
        while await asyncio.to_thread(_endpoints, shared.url) != BOTH:
            assert len(robots) < MOST
            robots.append(await stack.enter_async_context(shared.robot(f"r{len(robots)}")))
        around = [str((number - 1) % len(robots)) for number in range(len(robots))]
        assert await pass_around(robots, "first") == around
        killed = shared.pid(second)
        os.kill(killed, signal.SIGKILL)
        assert await pass_around(robots, "again") == around
        await until(lambda: shared.pid(second, but=killed))
