"""Fixtures for the tests of what services share: the map service has all of it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.map_service import Service


@pytest.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    """Running map service with a fake Master and a fake job runner."""
    service = Service(tmp_path / "maps")
    await service.start()
    yield service
    await service.stop()
