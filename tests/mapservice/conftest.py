"""What the tests of the map service share."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from maps_in_memory import Service


@pytest.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    """On a port, with a Master and workers that do what the test tells them."""
    service = Service(tmp_path / "maps")
    await service.start()
    yield service
    await service.stop()
