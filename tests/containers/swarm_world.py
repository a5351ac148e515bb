"""The outside of the engine `swarm`: a swarm of one machine."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

from engine_contract import CAPACITY, FEATURES, World, spec
from swarm_nodes import HOST_IMAGE, Node, Swarm, host_mounts
from twisted.internet.base import ReactorBase

from containers.engine import Ended, Engine
from containers.swarm import SwarmEngine
from containers.swarm_spec import AgentService
from rce.calls.environments import EnvironmentSpec
from rce.messages import ContainerData

COMMAND = ["/stand-in"]
IMAGE = "rce-test/stand-in:latest"


class SwarmWorld(World):
    def __init__(self, swarm: Swarm, directory: Path, reactor: ReactorBase) -> None:
        self.directory = directory
        self.node: Node = swarm.nodes[0]
        self.api = self.node.api()
        self.address = swarm.address
        self._reactor = reactor

    def engine(self, ended: Callable[[Ended], None], *behaviour: str, image: str = IMAGE) -> SwarmEngine:
        return SwarmEngine(
            CAPACITY,
            FEATURES,
            ended,
            reactor=self._reactor,
            platform="machine",
            directory=self.directory,
            master=f"tcp:{self.address}:1",
            image=image,
            settings={"typesupport": "/types"},
            agent=AgentService(HOST_IMAGE, self.address, mounts=host_mounts()),
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


def with_options(**options: Any) -> EnvironmentSpec:
    return EnvironmentSpec("ann/map", spec().run, "token", ContainerData(**options))
