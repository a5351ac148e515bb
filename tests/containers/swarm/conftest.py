"""Fixtures for tests of the engine `swarm`: its world, which all tests share, and an opened engine."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from tests.support.containers.engine_contract import Endings, opened


@pytest.fixture(scope="session")
def swarm_directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data directory of the task set on the swarm, which its agent belongs to."""
    return tmp_path_factory.mktemp("swarm")


@pytest.fixture
def world(
    one_machine: Any, swarm_directory: Path, reactor: ReactorBase, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Any]:
    from tests.support.containers.swarm_world import SwarmWorld

    monkeypatch.setenv("DOCKER_HOST", one_machine.nodes[0].host)
    world = SwarmWorld(one_machine, swarm_directory, reactor)
    world.reset()
    yield world
    world.api.close()


@pytest.fixture
async def engine(world: Any, endings: Endings) -> AsyncIterator[Any]:
    async with opened(world.engine(endings)) as engine:
        yield engine
    assert world.remains() == set()
    assert world.networks() == []
