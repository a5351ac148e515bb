"""The outside of the engine `swarm`: a swarm of one machine."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from container_world import IMAGE, ContainerWorld
from engine_contract import CAPACITY, FEATURES
from swarm_nodes import HOST_IMAGE, Node, Swarm, host_mounts
from twisted.internet.base import ReactorBase

from containers.engine import Ended
from containers.swarm import SwarmEngine
from containers.swarm_spec import AgentService


class SwarmWorld(ContainerWorld):
    def __init__(self, swarm: Swarm, directory: Path, reactor: ReactorBase) -> None:
        self.node: Node = swarm.nodes[0]
        super().__init__(directory, self.node.api(), reactor)
        self.address = swarm.address

    def engine(self, ended: Callable[[Ended], None], *behaviour: str, image: str = IMAGE) -> SwarmEngine:
        setup = self.setup(*behaviour, image=image, master=f"tcp:{self.address}:1")
        agent = AgentService(HOST_IMAGE, self.address, mounts=host_mounts())
        return SwarmEngine(CAPACITY, FEATURES, ended, setup, agent=agent)

    def there(self) -> set[str]:
        services = [each["Spec"]["Labels"] for each in self.api.services(filters=self.ours)]
        labels = [each["Labels"] for each in self.containers() + (self.api.volumes(filters=self.ours)["Volumes"] or [])]
        return {each["rce.environment"] for each in services + labels}

    def networks(self) -> list[str]:
        """They go a little later, as Swarm itself lets go of them."""
        return [each["Name"] for each in self.api.networks(filters=self.ours)]
