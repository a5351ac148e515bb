"""The host gets another address while an environment runs, as from a bridge of Docker, a VPN or Wi-Fi."""

from __future__ import annotations

import asyncio
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from rce.client import Publisher
from tests.support.e2e.real_platform import RealPlatform

STRING = "std_msgs/String"
BRIDGE, ADDRESS = "rce-test-0", "192.0.2.1/24"  # of the range for documentation


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
async def test_node_that_starts_after_the_change_is_found(platform: RealPlatform) -> None:
    async with platform.robot("mover") as robot, robot.environment("moved") as environment:
        with another_address():
            await environment.add_node("echo", "rce_demo", "echo.py")
            speak = await environment.publisher("/say", STRING)
            listen = await environment.subscriber("/heard", STRING)
            publishing = asyncio.create_task(_publish_repeatedly(speak))
            try:
                assert await listen.get(30) == {"data": "hello"}
            finally:
                publishing.cancel()


async def _publish_repeatedly(publisher: Publisher) -> None:
    """Publish until cancelled: messages are lost until DDS discovery has finished."""
    while True:
        await publisher.publish({"data": "hello"})
        await asyncio.sleep(0.2)
