# ruff: noqa: E402  (imports after importorskip)
"""The engine `swarm` with a real swarm of one machine: the contract, and the confinement of environments."""

from __future__ import annotations

import socket

import pytest

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.agents.connections import AgentAccess
from containers.endpoint import environment_user
from containers.swarm.engine import SwarmEngine
from rce.errors import LimitExceeded, NoCapacity, StartFailed
from tests.support.containers.container_contract import ContainerEngineContract, start_confined
from tests.support.containers.container_world import COMMAND, IMAGE
from tests.support.containers.engine_contract import Endings, opened, spec, with_options
from tests.support.containers.swarm_world import SwarmWorld


class TestSwarmEngine(ContainerEngineContract):
    pass


async def test_container_of_a_task_is_confined(world: SwarmWorld, engine: SwarmEngine) -> None:
    seen = await start_confined(world, engine)
    user = environment_user("ann/map")
    assert seen["Config"]["User"] == f"{user}:{user}"
    assert {mount["Destination"]: mount["RW"] for mount in seen["Mounts"]} == {
        "/run/rce": False,
        "/run/rce-user": False,
        "/home/rce": True,
        "/tmp": True,
        "/dev/shm": True,
    }
    (network,) = seen["NetworkSettings"]["Networks"].values()
    inside = world.api.inspect_network(network["NetworkID"])
    assert inside["Internal"]
    assert inside["Driver"] == "overlay"
    assert len(inside["Containers"]) <= 2  # the environment, and Docker's own endpoint


async def test_requests_that_no_node_fulfils_are_refused(world: SwarmWorld, engine: SwarmEngine) -> None:
    with pytest.raises(NoCapacity, match="insufficient resources"):
        await engine.start(with_options(gpus=1))
    with pytest.raises(LimitExceeded):
        await engine.start(with_options(memory=2**60))
    with pytest.raises(StartFailed, match=r"rce-test/nothing:1.*provision image"):
        await engine.start(with_options(image="rce-test/nothing:1"))
    assert world.remains() == set()


async def test_end_without_an_agent_is_reported_later(world: SwarmWorld, engine: SwarmEngine, endings: Endings) -> None:
    """Swarm restarts the agent, which then compares the containers with its record; running ones are not affected."""
    await engine.start(spec("ann/a", 1))
    await engine.start(spec("bob/b", 2))
    (agent,) = world.api.containers(filters={"label": [f"rce.directory={world.directory}", "rce.agent"]})
    world.api.kill(agent["Id"])
    await world.end("ann/a")
    ended = await endings.next(120)  # Swarm takes some seconds to restart the agent
    assert (ended.name, ended.status) == ("ann/a", 3)
    assert world.alive() == {"bob/b": spec(run=2).run}
    assert endings.none()


async def test_agents_join_at_another_port_if_theirs_is_in_use(world: SwarmWorld, engine: SwarmEngine) -> None:
    await engine.start(spec())
    await engine.close()
    port = AgentAccess.load(world.directory / "swarm.json").port
    with socket.create_server((world.address, port)):
        async with opened(world.engine(Endings())) as again:
            assert set(again.running()) == {"ann/map"}
            assert AgentAccess.load(world.directory / "swarm.json").port != port


async def test_leftovers_of_a_killed_task_set_are_removed(world: SwarmWorld, engine: SwarmEngine) -> None:
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
    async with opened(world.engine(Endings())) as again:
        assert set(again.running()) == {"ann/a"}
        assert world.remains() == {"ann/a"}
        assert "rce-left" not in world.networks()
