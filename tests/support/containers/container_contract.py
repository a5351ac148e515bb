"""Contract suite of engines that run containers: what every container is confined to, and its limits."""

from __future__ import annotations

from typing import Any

from containers.engine import Engine
from rce.protocol.slots import MB, PIDS
from tests.support.containers.container_world import ContainerWorld
from tests.support.containers.engine_contract import Endings, EngineContract, opened, with_options


class ContainerEngineContract(EngineContract):
    async def test_out_of_memory_is_reported(self, world: ContainerWorld, endings: Endings) -> None:
        async with opened(world.engine(endings, "eat")) as engine:
            await engine.start(with_options(memory=32 * MB))
            ended = await endings.next()
            assert ended.status == -9
            assert "memory of 32 MB" in ended.reason
            assert world.remains() == set()


async def start_confined(world: ContainerWorld, engine: Engine) -> dict[str, Any]:
    """Start the environment `ann/map`, check what is the same in all engines, and return what Docker knows of it."""
    await engine.start(with_options(memory=300 * MB, cpu=0.5, size=2))
    seen = world.inspect("ann/map")
    host = seen["HostConfig"]
    assert host["CapDrop"] == ["ALL"]
    assert not host["CapAdd"]
    assert not host["Privileged"]
    assert host["ReadonlyRootfs"]
    assert host["Memory"] == 300 * MB
    assert (host["NanoCpus"], host["PidsLimit"]) == (500_000_000, 2 * PIDS)
    assert host["LogConfig"]["Config"] == {"max-size": "2m", "max-file": "2"}
    return seen
