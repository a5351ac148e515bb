"""Fixtures for tests of task sets: images of a small program, a swarm of one machine, a Master and opened engines."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from twisted.internet.base import ReactorBase

from containers.engine import Engine
from rce import __version__
from tests.support.containers.engine_contract import Endings, World, opened
from tests.support.containers.fake_master import FakeMaster
from tests.support.containers.stand_in_image import stand_in_layer

STAND_IN = "rce-test/stand-in:latest"


@pytest.fixture(scope="session")
def stand_in(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The only layer of the image."""
    return stand_in_layer(tmp_path_factory.mktemp("stand-in"))


def load(host: str, layer: bytes) -> None:
    """Import the image into a daemon."""
    import docker

    api = docker.APIClient(base_url=host, version="auto")
    name, _, tag = STAND_IN.partition(":")
    api.import_image_from_data(layer, repository=name, tag=tag, changes=[f"LABEL rce.version={__version__}"])
    api.close()


@pytest.fixture(scope="session")
def stand_in_image(docker_host: str, stand_in: bytes) -> str:
    load(docker_host, stand_in)
    return STAND_IN


@pytest.fixture(scope="session")
def load_stand_in(stand_in: bytes) -> Callable[[str], None]:
    """Function that imports the image into a daemon of a test's own."""
    return lambda host: load(host, stand_in)


@pytest.fixture(scope="session")
def one_machine(stand_in: bytes) -> Iterator[Any]:
    """A swarm of one machine with the images; its agent runs on from one test to the next, as it does for task sets."""
    pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")
    from tests.support.swarm_nodes import load_host_image, swarm_of

    with swarm_of(1) as made:
        load(made.nodes[0].host, stand_in)
        load_host_image(made.nodes[0])
        yield made


@pytest.fixture(scope="session")
def cluster(stand_in: bytes) -> Iterator[Any]:
    """A Kubernetes cluster of one node with the images; its agent runs on from one test to the next."""
    pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")
    from tests.support.kubernetes.cluster import cluster_of
    from tests.support.kubernetes.images import load_images

    with cluster_of(1, lambda node: load_images(node, stand_in)) as made:
        yield made


@pytest.fixture
def docker_world(tmp_path: Path, stand_in_image: str, reactor: ReactorBase) -> Iterator[Any]:
    from tests.support.containers.docker_world import DockerWorld

    world = DockerWorld(tmp_path, stand_in_image, reactor)
    yield world
    world.api.close()


@pytest.fixture
async def master(reactor: ReactorBase) -> AsyncIterator[FakeMaster]:
    master = FakeMaster(reactor)
    await master.up()
    yield master
    await master.close()


@pytest.fixture
def endings() -> Endings:
    return Endings()


@pytest.fixture
async def engine(world: World, endings: Endings) -> AsyncIterator[Engine]:
    """An open engine of the module's `world`."""
    async with opened(world.engine(endings)) as engine:
        yield engine
    assert world.remains() == set()
