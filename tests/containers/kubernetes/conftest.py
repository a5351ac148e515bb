"""Fixtures for tests of the engine `kubernetes`: its world, which all tests share, and an opened engine."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from tests.support.containers.engine_contract import Endings, opened


@pytest.fixture(scope="session")
def task_set_directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data directory of the task set, which its agents belong to."""
    return tmp_path_factory.mktemp("kubernetes")


@pytest.fixture
def world(cluster: Any, task_set_directory: Path, reactor: ReactorBase) -> Any:
    from tests.support.containers.kubernetes_world import KubernetesWorld

    world = KubernetesWorld(cluster, task_set_directory, reactor)
    world.reset()
    return world


@pytest.fixture
async def engine(world: Any, endings: Endings) -> AsyncIterator[Any]:
    async with opened(world.engine(endings)) as engine:
        yield engine
    assert world.remains() == set()
