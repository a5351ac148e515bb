"""World of the engine `swarm`: a swarm of one machine."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from twisted.internet.base import ReactorBase

from containers.engine import EnvironmentEnded
from containers.swarm.engine import SwarmEngine
from containers.swarm.spec import AgentService
from tests.support.containers.container_world import IMAGE, ContainerWorld
from tests.support.containers.engine_contract import CAPACITY, FEATURES
from tests.support.swarm_nodes import HOST_IMAGE, Node, Swarm, host_mounts

RESET_TIMEOUT = 60.0  # seconds


class SwarmWorld(ContainerWorld):
    def __init__(self, swarm: Swarm, directory: Path, reactor: ReactorBase) -> None:
        self.node: Node = swarm.nodes[0]
        super().__init__(directory, self.node.api(), reactor)
        self.address = swarm.address

    def engine(self, ended: Callable[[EnvironmentEnded], None], *behaviour: str, image: str = IMAGE) -> SwarmEngine:
        setup = self.setup(*behaviour, image=image, master=f"tcp:{self.address}:1")
        agent = AgentService(HOST_IMAGE, self.address, mounts=host_mounts())
        return SwarmEngine(CAPACITY, FEATURES, ended, setup, agent=agent)

    def reset(self) -> None:
        """Remove what a failed test has left on the swarm, which is shared by all tests.

        Swarm removes ended containers late, and agents cannot tell them from later ones, as tests use the same runs.
        """
        for service in self.api.services(filters=self.own_filter):
            self.api.remove_service(service["ID"])
        deadline = time.monotonic() + RESET_TIMEOUT
        while self.remains():
            assert time.monotonic() < deadline, f"left by an earlier test: {self.remains()}"
            time.sleep(0.1)

    def remains(self) -> set[str]:
        services = [each["Spec"]["Labels"] for each in self.api.services(filters=self.own_filter)]
        labels = [
            each["Labels"] for each in self.containers() + (self.api.volumes(filters=self.own_filter)["Volumes"] or [])
        ]
        return {each["rce.environment"] for each in services + labels}

    def networks(self) -> list[str]:
        """Return the task set's networks, which Swarm removes a little later than their services."""
        return [each["Name"] for each in self.api.networks(filters=self.own_filter)]
