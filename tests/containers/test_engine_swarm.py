# ruff: noqa: E402  (Docker is imported only where it is there)
"""The engine `swarm` with a real swarm of one machine: the contract, and how its environments are kept."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from engine_contract import CAPACITY, FEATURES, Endings, EngineContract, World, spec
from twisted.internet.base import ReactorBase

docker = pytest.importorskip("docker", reason="needs docker-py: pip install 'rce[docker]'")

from swarm_nodes import HOST_IMAGE, Node, Swarm, host_mounts, load_host_image, swarm_of

from containers.engine import Ended, Engine
from containers.swarm import SwarmEngine
from containers.swarm_spec import AgentService
from rce.calls import EnvironmentSpec
from rce.errors import InvalidRequest, LimitExceeded, NoCapacity, StartFailed
from rce.messages import ContainerData, Rates
from rce.slots import MB, PIDS

COMMAND = ["/stand-in"]
IMAGE = "rce-test/stand-in:latest"


class SwarmWorld(World):
    def __init__(self, swarm: Swarm, directory: Path, reactor: ReactorBase) -> None:
        self.directory = directory
        self.node: Node = swarm.nodes[0]
        self.api = self.node.api()
        self._address = swarm.address
        self._reactor = reactor

    def engine(self, ended: Callable[[Ended], None], *behaviour: str, image: str = IMAGE) -> SwarmEngine:
        return SwarmEngine(
            CAPACITY,
            FEATURES,
            ended,
            reactor=self._reactor,
            platform="machine",
            directory=self.directory,
            master=f"tcp:{self._address}:1",
            image=image,
            settings={"typesupport": "/types"},
            agent=AgentService(HOST_IMAGE, self._address, 0, host_mounts()),
            command=[*COMMAND, *behaviour],
        )

    def break_start(self, engine: Engine) -> None:
        assert isinstance(engine, SwarmEngine)
        engine._command = ["/nonexistent/program"]

    async def end(self, name: str) -> None:
        (container,) = [each["Id"] for each in self.containers() if each["Labels"]["rce.environment"] == name]
        await asyncio.to_thread(self.api.kill, container, "SIGUSR1")
        await asyncio.to_thread(self.api.wait, container)

    def containers(self) -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self.api.containers(all=True, filters=self.ours)
        return [each for each in found if "rce.run" in each["Labels"]]

    @property
    def ours(self) -> dict[str, list[str]]:
        return {"label": [f"rce.directory={self.directory}", "rce.run"]}

    def there(self) -> set[str]:
        services = [each["Spec"]["Labels"] for each in self.api.services(filters=self.ours)]
        labels = [each["Labels"] for each in self.containers() + (self.api.volumes(filters=self.ours)["Volumes"] or [])]
        return {each["rce.environment"] for each in services + labels}

    def networks(self) -> list[str]:
        """They go a little later, as Swarm itself lets go of them."""
        return [each["Name"] for each in self.api.networks(filters=self.ours)]

    def alive(self) -> dict[str, str]:
        labels = [each["Labels"] for each in self.containers() if each["State"] == "running"]
        return {each["rce.environment"]: each["rce.run"] for each in labels}

    def inspect(self, name: str) -> dict[str, Any]:
        (container,) = [each["Id"] for each in self.containers() if each["Labels"]["rce.environment"] == name]
        seen: dict[str, Any] = self.api.inspect_container(container)
        return seen


@pytest.fixture(scope="module")
def swarm(load_stand_in: Callable[[str], None]) -> Iterator[Swarm]:
    with swarm_of(1) as made:
        before = os.environ.get("DOCKER_HOST")
        os.environ["DOCKER_HOST"] = made.nodes[0].host
        load_stand_in(made.nodes[0].host)
        load_host_image(made.nodes[0])
        yield made
        os.environ.pop("DOCKER_HOST")
        if before is not None:
            os.environ["DOCKER_HOST"] = before


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One for all tests, so that the agent stays from one to the next, as it does for a task set."""
    return tmp_path_factory.mktemp("swarm")


@pytest.fixture
def world(swarm: Swarm, directory: Path, reactor: ReactorBase) -> Iterator[SwarmWorld]:
    world = SwarmWorld(swarm, directory, reactor)
    yield world
    world.api.close()


@pytest.fixture
def endings() -> Endings:
    return Endings()


class TestSwarmEngine(EngineContract):
    @pytest.fixture
    def world(self, swarm: Swarm, directory: Path, reactor: ReactorBase) -> Iterator[SwarmWorld]:
        world = SwarmWorld(swarm, directory, reactor)
        yield world
        world.api.close()


@pytest.fixture
async def engine(world: SwarmWorld, endings: Endings) -> AsyncIterator[SwarmEngine]:
    engine = world.engine(endings)
    await engine.open()
    yield engine
    await engine.keep([])
    await engine.close()
    assert world.there() == set()
    assert world.networks() == []


def with_options(**options: Any) -> EnvironmentSpec:
    return EnvironmentSpec("ann/map", spec().run, "token", ContainerData(**options))


async def test_the_walls_of_a_task(world: SwarmWorld, engine: SwarmEngine) -> None:
    await engine.start(with_options(memory=300 * MB, cpu=0.5, size=2))
    seen = world.inspect("ann/map")
    host = seen["HostConfig"]
    assert host["CapDrop"] == ["ALL"]
    assert not host["CapAdd"]
    assert not host["Privileged"]
    assert host["ReadonlyRootfs"]
    assert host["Memory"] == 300 * MB
    assert (host["NanoCpus"], host["PidsLimit"]) == (500_000_000, 2 * PIDS)
    assert seen["Config"]["User"] == "10000:10000"
    assert host["LogConfig"]["Config"] == {"max-size": "2m", "max-file": "2"}
    assert {mount["Destination"]: mount["RW"] for mount in seen["Mounts"]} == {
        "/run/rce": False,
        "/run/rce-user": True,
        "/home/rce": True,
        "/tmp": True,
        "/dev/shm": True,
    }
    (network,) = seen["NetworkSettings"]["Networks"].values()
    inside = world.api.inspect_network(network["NetworkID"])
    assert inside["Internal"]
    assert inside["Driver"] == "overlay"
    assert len(inside["Containers"]) <= 2  # itself, and Docker's own end


@pytest.mark.parametrize("options", [{"disk": MB}, {"bandwidth": MB}, {"io": Rates(read=MB)}, {"groupIP": "10.1.1.9"}])
async def test_what_services_do_not_have_is_refused(engine: SwarmEngine, options: dict[str, Any]) -> None:
    with pytest.raises(InvalidRequest, match="use docker") as raised:
        await engine.start(with_options(**options))
    assert raised.value.field == f"containerData.{next(iter(options))}"


async def test_what_no_node_has(world: SwarmWorld, engine: SwarmEngine) -> None:
    with pytest.raises(NoCapacity, match="insufficient resources"):
        await engine.start(with_options(gpus=1))
    with pytest.raises(LimitExceeded):
        await engine.start(with_options(memory=2**60))
    with pytest.raises(StartFailed, match=r"rce-test/nothing:1.*provision image"):
        await engine.start(with_options(image="rce-test/nothing:1"))
    assert world.there() == set()


async def test_using_up_the_memory_is_told(world: SwarmWorld, endings: Endings) -> None:
    engine = world.engine(endings, "eat")
    await engine.open()
    await engine.start(with_options(memory=32 * MB))
    ended = await endings.next()
    assert ended.status == -9
    assert "memory of 32 MB" in ended.reason
    await engine.close()


async def test_an_end_while_there_is_no_agent(world: SwarmWorld, engine: SwarmEngine, endings: Endings) -> None:
    """Swarm starts the agent again, which looks at what is there; what lives on is left alone."""
    await engine.start(spec("ann/a", 1))
    await engine.start(spec("bob/b", 2))
    (agent,) = world.api.containers(filters={"label": [f"rce.directory={world.directory}", "rce.agent"]})
    world.api.kill(agent["Id"])
    await world.end("ann/a")
    async with asyncio.timeout(30):
        ended = await endings._queue.get()
    assert (ended.name, ended.status) == ("ann/a", 3)
    assert world.alive() == {"bob/b": spec(run=2).run}
    assert endings.none()


async def test_leftovers_of_a_killed_task_set(world: SwarmWorld, engine: SwarmEngine) -> None:
    await engine.start(spec("ann/a", 1))
    await engine.close()
    platform = {"rce.platform": "machine", "rce.directory": str(world.directory)}
    labels = {**platform, "rce.environment": "eve/d", "rce.run": spec(run=9).run, "rce.size": "1"}
    world.api.create_network("rce-left", driver="overlay", scope="swarm", labels=platform)
    world.api.create_volume("rce-left", labels=labels)
    task = {
        "ContainerSpec": {"Image": IMAGE, "Args": COMMAND, "Labels": labels},
        "RestartPolicy": {"Condition": "none"},
    }
    world.api.create_service(task, "rce-left", labels, {"Replicated": {"Replicas": 0}})
    again = world.engine(Endings())
    await again.open()
    assert set(again.running()) == {"ann/a"}
    assert world.there() == {"ann/a"}
    assert "rce-left" not in world.networks()
    await again.keep([])
    await again.close()
