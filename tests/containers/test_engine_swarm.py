# ruff: noqa: E402  (Docker is imported only where it is there)
"""The engine `swarm` with a real swarm of one machine: the contract, and how its environments are kept."""

from __future__ import annotations

import asyncio

import pytest

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from container_world import COMMAND, IMAGE
from engine_contract import Endings, EngineContract, spec, with_options
from swarm_world import SwarmWorld

from containers.swarm import SwarmEngine
from rce.errors import LimitExceeded, NoCapacity, StartFailed
from rce.slots import MB, PIDS


class TestSwarmEngine(EngineContract):
    pass


@pytest.fixture
def world(swarm_world: SwarmWorld) -> SwarmWorld:
    return swarm_world


@pytest.fixture
async def engine(swarm_engine: SwarmEngine) -> SwarmEngine:
    return swarm_engine


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
