"""Fake of the robot's own ROS, for the parts of a bridge that use it."""

from __future__ import annotations

from typing import cast

import msgspec

from endpoints.bridge.local_ros import CLOUD, CloudLink, LocalRos, MakeInterface
from endpoints.data.frames import Message
from endpoints.data.link import Link
from endpoints.data.traffic import InterfaceCounter
from endpoints.environment.interfaces import RosInterface
from rce.errors import RceError, UnknownType
from rce.protocol.blobs import Buffer
from rce.protocol.messages import Qos

NODE = b"n" * 16


class FakeInterface:
    """Interface of the robot's ROS. It records what the bridge gives it, and sends the bridge what a test says."""

    def __init__(self, make: MakeInterface, type_name: str, address: str, link: CloudLink, qos: Qos | None) -> None:
        self.make, self.type_name, self.address, self.link, self.qos = make, type_name, address, link, qos
        self.received: list[Message] = []
        self.traffic = InterfaceCounter()

    def receive(self, message: Message, link: Link) -> None:
        self.received.append(message)

    def payloads(self) -> list[bytes]:
        return [bytes(message.payload) for message in self.received]

    def send(self, payload: Buffer, msg_id: str = "", *, keep: int | None = 1) -> int:
        """Send a message of the robot's ROS; return the number of older ones that the bridge dropped."""
        return self.link.send(Message(NODE, msg_id, payload), keep)

    def fail(self, msg_id: str, error: RceError) -> None:
        """Answer a request with an error."""
        self.link.send(Message(NODE, msg_id, msgspec.msgpack.encode(error.info), CLOUD, error=True), None)


class FakeLocalRos(LocalRos):
    """The robot's own ROS without ROS.

    Attributes:
        interfaces: Present interfaces by their addresses.
        refusals: Errors by the addresses whose interfaces cannot be created; each is raised once.
        texts: Definitions by type.
    """

    def __init__(self) -> None:
        self.interfaces: dict[str, FakeInterface] = {}
        self.refusals: dict[str, RceError] = {}
        self.texts: dict[str, dict[str, str]] = {}

    async def add_interface(
        self, make: MakeInterface, type_name: str, address: str, link: CloudLink, qos: Qos | None = None
    ) -> RosInterface:
        if address in self.refusals:
            raise self.refusals.pop(address)
        made = self.interfaces[address] = FakeInterface(make, type_name, address, link, qos)
        return cast(RosInterface, made)

    def remove_interface(self, interface: RosInterface) -> None:
        del self.interfaces[cast(FakeInterface, interface).address]

    def describe(self, type_name: str) -> dict[str, str]:
        if type_name not in self.texts:
            raise UnknownType(f"no type {type_name}")
        return self.texts[type_name]
