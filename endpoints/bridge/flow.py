"""Base of the flows of a bridge, each of which connects an interface in the robot's ROS with one in the environment."""

from __future__ import annotations

from abc import ABC, abstractmethod

from endpoints.bridge.local_ros import CLOUD, CloudLink, LocalRos, MakeInterface
from endpoints.data.frames import Message
from endpoints.environment.interfaces import RosInterface
from rce.client import Environment
from rce.protocol.messages import Qos


class Flow(CloudLink, ABC):
    """A topic, service or action that is forwarded; it is the link of its interface in the robot's ROS."""

    def __init__(self) -> None:
        super().__init__()
        self._local: LocalRos | None = None
        self._interface: RosInterface | None = None

    @abstractmethod
    async def open(self, local: LocalRos, environment: Environment) -> None:
        """Create the interfaces at both ends; raise RceError if one of them is rejected."""

    async def add_local_interface(
        self, local: LocalRos, make: MakeInterface, type_name: str, address: str, qos: Qos | None = None
    ) -> None:
        """Create the interface in the robot's ROS."""
        self._local, self._interface = local, await local.add_interface(make, type_name, address, self, qos)

    def deliver(self, message: Message) -> None:
        """Pass a message of the environment to the robot's ROS."""
        if self._interface is not None:
            self._interface.traffic.of(CLOUD).count(len(message.payload))
            self._interface.receive(message, self)

    def end(self) -> None:
        """Remove the interface in the robot's ROS; that in the environment ends with the robot's session."""
        if self._local is not None and self._interface is not None:
            self._local.remove_interface(self._interface)
        self._interface = None
