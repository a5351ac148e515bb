"""The two ends of what a bridge carries: interfaces in the robot's ROS, and links that lead to the platform."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

from twisted.logger import Logger

from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.interfaces import RosInterface, Surroundings
from endpoints.environment.ros import RosThread
from endpoints.frames import Message
from endpoints.hops import Watch
from endpoints.traffic import Totals
from rce.calls.endpoints import InterfaceSpec
from rce.errors import RceError
from rce.messages import Qos
from rce.metrics import Family

CLOUD = bytes(16)  # what the platform is called among the peers of a local interface
TICK = 1.0

log = Logger()
MakeInterface = Callable[[InterfaceSpec, Surroundings], RosInterface]


class CloudEnd:
    """The platform's end, as a link of the interface in the robot's ROS. Nothing waits in it."""

    name = "cloud"

    def __init__(self) -> None:
        self.opened: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.opened.set_result(None)

    def send(self, message: Message, keep: int | None) -> int:
        """Take a message of the robot's ROS; returns how many older ones were dropped for it."""
        raise NotImplementedError

    def room(self, source: bytes) -> asyncio.Future[None] | None:
        return None

    def backlog(self, source: bytes) -> int:
        return 0

    def forget(self, source: bytes) -> None:
        """Nothing waits here."""

    def pause(self, until: asyncio.Future[None]) -> None:
        """The interfaces of a bridge keep the newest messages: they never ask for a pause."""

    def close(self) -> None:
        """There is nothing to end."""


class LocalRos:
    """The robot's own ROS: makes interfaces there, of the same kinds as environments have, each with one peer."""

    def __init__(self, ros: RosThread, prefixes: Sequence[Path]) -> None:
        self._definitions = InstalledTypes(prefixes)
        self._around = Surroundings(ros, Watch(), self._definitions, self._report)
        self._interfaces: set[RosInterface] = set()
        self._totals = Totals()
        self._ticker = asyncio.create_task(self._tick())

    async def interface(
        self,
        make: MakeInterface,
        type_name: str,
        address: str,
        link: CloudEnd,
        qos: Qos | None = None,
    ) -> RosInterface:
        """An interface whose peer is `link`. UnknownType, InvalidRequest."""
        spec = InterfaceSpec(uuid.uuid4().hex, "bridge", address, "", type_name, address, qos or Qos())
        interface = make(spec, self._around)
        await interface.open()
        interface.peers[CLOUD] = link
        self._interfaces.add(interface)
        interface.joined(CLOUD)
        interface.started()
        return interface

    def describe(self, type_name: str) -> dict[str, str]:
        """The definition of a message type and of all that it uses, by `pkg/msg/Name`. UnknownType."""
        return self._definitions.describe(type_name, False)

    def remove(self, interface: RosInterface) -> None:
        self._interfaces.discard(interface)
        self._totals.gone(interface.traffic.traffic(interface.dropped))
        interface.peers.clear()
        interface.stopped()
        interface.close()

    def families(self) -> list[Family]:
        """What was carried: `sent` to the platform, and `received` from it."""
        return self._totals.families(each.traffic.traffic(each.dropped) for each in self._interfaces)

    def close(self) -> None:
        self._ticker.cancel()
        for interface in list(self._interfaces):
            self.remove(interface)

    async def _tick(self) -> None:
        """Their time-outs."""
        loop = asyncio.get_running_loop()
        while True:
            await asyncio.sleep(TICK)
            for interface in list(self._interfaces):
                interface.tick(loop.time())

    @staticmethod
    def _report(spec: InterfaceSpec, error: RceError) -> None:
        """Interfaces log what they complain of; here is nobody else who would want to hear it."""
