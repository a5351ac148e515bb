"""Fixtures for the tests of the knowledge service."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rce.knowledge.repository import Repository
from rce.knowledge.texts import Texts
from tests.support.knowledge import LIMITS, Service, SharedWorker


@pytest.fixture(scope="session")
async def worker() -> AsyncIterator[SharedWorker]:
    """Process that reads texts for all tests."""
    worker = SharedWorker()
    yield worker
    await worker.close()


@pytest.fixture
async def service(tmp_path: Path, worker: SharedWorker) -> AsyncIterator[Service]:
    """Running knowledge service with a fake Master."""
    async with Service(tmp_path / "knowledge", worker=worker) as service:
        yield service


@pytest.fixture
async def repository(tmp_path: Path, worker: SharedWorker) -> AsyncIterator[Repository]:
    """Repository without a service."""
    repository = Repository(tmp_path / "repository", LIMITS.repository, Texts(lambda: worker))
    await repository.start()
    yield repository
    await repository.stop()
