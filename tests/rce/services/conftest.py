"""Fixtures for the tests of what services share: the map service has all of it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.map_service import Service


@pytest.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    """Running map service with a fake Master and a fake job runner."""
    async with Service(tmp_path / "maps") as service:
        yield service
