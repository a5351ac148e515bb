"""What the interfaces of an environment share, and which class an interface is of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from twisted.logger import Logger

from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.ros import RosThread, Waited
from endpoints.hops import Watch
from endpoints.interface import Interface
from rce.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, RceError

log = Logger()
W = TypeVar("W", bound=Waited)


@dataclass(frozen=True)
class Surroundings:
    """What an interface needs of its endpoint; `report` tells its owner of a failure."""

    ros: RosThread
    watch: Watch
    definitions: InstalledTypes
    report: Callable[[InterfaceSpec, RceError], None]


class RosInterface(Interface):
    """An interface with an entity of ROS, which `open` makes."""

    def __init__(self, spec: InterfaceSpec, around: Surroundings) -> None:
        super().__init__(spec, around.watch)
        self._ros = around.ros
        self._around = around
        self._complaints: set[str] = set()

    async def open(self) -> None:
        """UnknownType; InvalidRequest for an `addr` that ROS does not take."""
        raise NotImplementedError

    def tick(self, now: float) -> None:
        """Called every second."""

    async def _make(self, make: Callable[[], W]) -> W:
        try:
            return await self._ros.run(make)
        except (InvalidTopicNameException, InvalidServiceNameException, ValueError, _rclpy.RCLError) as error:
            reason = " ".join(str(error).split())
            raise InvalidRequest(
                f"interface {self.spec.tag}: addr {self.spec.addr!r} cannot be used in ROS: {reason}", field="addr"
            ) from None

    def _complain(self, error: RceError) -> None:
        """Log and report; what was said once is not said again."""
        if str(error) not in self._complaints and len(self._complaints) < 100:
            self._complaints.add(str(error))
            log.warn("{owner} {tag}: {error}", owner=self.spec.owner, tag=self.spec.tag, error=str(error))
            self._around.report(self.spec, error)

    def _complain_from_ros(self, kind: type[RceError], sentence: str) -> None:
        """The same, called in the ROS thread."""
        self._ros.deliver(lambda: self._complain(kind(f"interface {self.spec.tag}: {sentence}")))


def raw(payload: Any) -> bytes:
    return payload if isinstance(payload, bytes) else bytes(payload)
