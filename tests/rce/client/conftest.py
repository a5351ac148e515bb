"""Fake platforms for the tests of the client."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from tests.support.fake_platform import FakePlatform


@pytest.fixture
async def fake() -> AsyncIterator[FakePlatform]:
    async with FakePlatform() as platform:
        yield platform


@pytest.fixture
async def original() -> AsyncIterator[FakePlatform]:
    """A server of the original, which knows no features."""
    async with FakePlatform(None) as platform:
        yield platform
