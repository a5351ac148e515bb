"""The robot's own ROS: its interfaces, and the links from them to the platform."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

from twisted.logger import Logger

from endpoints.data.hops import HopRecorder
from endpoints.data.sink import Sink
from endpoints.data.traffic import TrafficTotals
from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.interfaces import RosContext, RosInterface
from endpoints.environment.ros import Ros
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import RceError
from rce.process.metrics import Family
from rce.protocol.messages import Qos

CLOUD = bytes(16)  # id of the platform as the peer of a local interface
TICK = 1.0  # seconds

log = Logger()
MakeInterface = Callable[[InterfaceSpec, RosContext], RosInterface]


class CloudLink(Sink):
    """Link from an interface in the robot's ROS to the platform."""

    name = "cloud"
    to_environment = True  # so that what came from there is not sent back


class LocalRos:
    """Interfaces in the robot's own ROS, of the same kinds as in environments, each with one peer."""

    def __init__(self, ros: Ros, prefixes: Sequence[Path]) -> None:
        self._definitions = InstalledTypes(prefixes)
        self._context = RosContext(ros, HopRecorder(), self._definitions, self._ignore_report)
        self._interfaces: set[RosInterface] = set()
        self._totals = TrafficTotals()
        self._ticker = asyncio.create_task(self._tick())

    async def add_interface(
        self,
        make: MakeInterface,
        type_name: str,
        address: str,
        link: CloudLink,
        qos: Qos | None = None,
    ) -> RosInterface:
        """Create an interface whose peer is `link`.

        Args:
            make: Class of the interface.
            type_name: Type of its messages or service.
            address: Name of its topic or service in ROS.
            link: Link to the platform.
            qos: Quality of service; None for the default.

        Raises:
            UnknownType: The type is not installed.
            InvalidRequest: ROS rejects the address.
        """
        spec = InterfaceSpec(uuid.uuid4().hex, "bridge", address, "", type_name, address, qos or Qos())
        interface = make(spec, self._context)
        await interface.open()
        interface.peers[CLOUD] = link
        self._interfaces.add(interface)
        interface.joined(CLOUD)
        interface.started()
        return interface

    def describe(self, type_name: str) -> dict[str, str]:
        """Return the definitions of a message type and of all types that it uses, by `pkg/msg/Name`.

        Raises:
            UnknownType: One of the types is not installed.
        """
        return self._definitions.describe(type_name, "msg")

    def remove_interface(self, interface: RosInterface) -> None:
        """Remove an interface."""
        self._interfaces.discard(interface)
        self._totals.add_removed(interface.counted)
        interface.peers.clear()
        interface.stopped()
        interface.close()

    def families(self) -> list[Family]:
        """Return the traffic as metrics: messages `sent` to the platform and `received` from it."""
        return self._totals.families(each.counted for each in self._interfaces)

    def close(self) -> None:
        """Remove all interfaces."""
        self._ticker.cancel()
        for interface in list(self._interfaces):
            self.remove_interface(interface)

    async def _tick(self) -> None:
        """Let the interfaces process their timeouts once a second."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(TICK)
            for interface in list(self._interfaces):
                interface.tick(loop.time())

    @staticmethod
    def _ignore_report(spec: InterfaceSpec, error: RceError) -> None:
        """Ignore an error of an interface, which has logged it already."""
