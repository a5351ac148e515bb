"""The host gets another address while an environment runs, as from a bridge of Docker, a VPN or Wi-Fi."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.support.e2e.real_platform import RealPlatform
from tests.support.e2e.traffic import Echo

BRIDGE, ADDRESS = f"rce-t{os.getpid()}", "192.0.2.1/24"  # of the range for documentation


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
    subprocess.run(["ip", *words], check=True, timeout=60)


@pytest.mark.skipif(os.geteuid() != 0, reason="gives this host another address: needs root")
async def test_node_that_starts_after_the_change_is_found(platform: RealPlatform) -> None:
    async with platform.robot("mover") as robot, robot.environment("moved") as environment:
        with another_address():
            await (await Echo.of(environment)).answers()
