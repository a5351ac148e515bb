"""Fixtures for the tests of the map service."""

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
