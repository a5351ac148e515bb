"""Platforms to attack: one in this process, one of processes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest
from platforms import Platform, Processes
from twisted.internet.base import ReactorBase

from endpoints.robot.door import ServerLimits

MakePlatform = Callable[..., Any]


@pytest.fixture
async def make_platform(reactor: ReactorBase) -> AsyncIterator[MakePlatform]:
    made: list[Platform] = []

    async def make(*, grace: float = 10.0, service_timeout: float = 30.0, **limits: Any) -> Platform:
        platform = Platform(reactor, ServerLimits(**limits), grace, service_timeout)
        await platform.start()
        made.append(platform)
        return platform

    yield make
    for platform in made:
        await platform.stop()
    await asyncio.sleep(0)


@pytest.fixture
async def platform(make_platform: MakePlatform) -> Platform:
    made: Platform = await make_platform()
    return made


@pytest.fixture
async def processes(tmp_path: Path) -> AsyncIterator[Processes]:
    made = Processes(tmp_path)
    try:
        yield made
    finally:
        if hasattr(made, "port"):
            await made.close()
        await made.stop()
