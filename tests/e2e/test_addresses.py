"""A host gets another address while an environment runs, as with each bridge of Docker's, a VPN or Wi-Fi."""

from __future__ import annotations

import asyncio
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from real_platform import RealPlatform

from rce.client import Publisher

STRING = "std_msgs/String"
BRIDGE, ADDRESS = "rce-test-0", "192.0.2.1/24"  # of the range for documentation: nobody has it


@contextmanager
def another_address() -> Iterator[None]:
    ip("link", "add", BRIDGE, "type", "bridge")
    try:
        ip("address", "add", ADDRESS, "dev", BRIDGE)
        ip("link", "set", BRIDGE, "up")
        yield
    finally:
        ip("link", "delete", BRIDGE)


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, timeout=10)


@pytest.mark.skipif(os.geteuid() != 0, reason="gives this host another address: needs root")
async def test_a_node_that_starts_then_is_heard(platform: RealPlatform) -> None:
    async with platform.robot("mover") as robot, robot.environment("moved") as environment:
        with another_address():
            await environment.add_node("echo", "rce_demo", "echo.py")
            speak = await environment.publisher("/say", STRING)
            listen = await environment.subscriber("/heard", STRING)
            async with asyncio.timeout(30):
                saying = asyncio.create_task(_say(speak))
                heard = await listen.get()
                saying.cancel()
            assert heard == {"data": "hello"}


async def _say(speak: Publisher) -> None:
    while True:
        await speak.publish({"data": "hello"})
        await asyncio.sleep(0.2)
