"""Fixtures for the tests of the knowledge service."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rce.knowledge.repository import Repository
from rce.knowledge.texts import Texts
from tests.support.knowledge import LIMITS, Service


@pytest.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    """Running knowledge service with a fake Master."""
    async with Service(tmp_path / "knowledge") as service:
        yield service


@pytest.fixture
async def repository(tmp_path: Path) -> AsyncIterator[Repository]:
    """Repository without a service."""
    repository = Repository(tmp_path / "repository", LIMITS.repository, Texts())
    await repository.start()
    yield repository
    await repository.stop()
