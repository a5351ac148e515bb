"""Base of the interfaces of an environment."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

from rclpy.exceptions import InvalidServiceNameException, InvalidTopicNameException
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from twisted.logger import Logger

from endpoints.data.hops import HopRecorder
from endpoints.data.interface import Interface
from endpoints.environment.definitions import InstalledTypes
from endpoints.environment.ros import Ros
from endpoints.environment.service_slots import ServiceSlots
from endpoints.environment.shared_subscription import SharedSubscriptions
from endpoints.environment.shared_topics import SharedTopics
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, LimitExceeded, RceError
from rce.net.budget import MB, Budget
from rce.spelling import with_article

log = Logger()
QUEUES = 128 * MB  # bytes of all messages of an environment that wait
MAX_REPORTED = 100  # different errors that one interface reports
W = TypeVar("W")


@dataclass(frozen=True)
class RosContext:
    """Parts of the endpoint that its interfaces use. `report` sends an error to the owner of an interface."""

    ros: Ros
    hops: HopRecorder
    definitions: InstalledTypes
    report: Callable[[InterfaceSpec, RceError], None]
    budget: Budget = field(default_factory=lambda: Budget(QUEUES))
    shared: SharedTopics = field(default_factory=SharedTopics)
    slots: ServiceSlots = field(default_factory=ServiceSlots)

    @cached_property
    def subscriptions(self) -> SharedSubscriptions:
        """Subscriptions that interfaces share."""
        return SharedSubscriptions(self.ros, self.shared, self.budget)


class RosInterface(Interface):
    """Interface with a ROS entity, which `open` creates."""

    def __init__(self, spec: InterfaceSpec, context: RosContext) -> None:
        super().__init__(spec, context.hops, context.budget)
        self._ros = context.ros
        self._context = context
        self._reported: set[str] = set()  # texts of reported errors

    async def open(self) -> None:
        """Create the ROS entity.

        Raises:
            UnknownType: The type is not installed, or has no type support.
            InvalidRequest: `addr` is not a valid ROS name.
            LimitExceeded: The environment has too many interfaces.
        """
        raise NotImplementedError

    def tick(self, now: float) -> None:
        """Do what is due; called once a second with the monotonic time."""

    def _create(self, create: Callable[[], W]) -> W:
        try:
            return create()
        except (InvalidTopicNameException, InvalidServiceNameException, ValueError, _rclpy.RCLError) as error:
            problem = f"ROS rejects addr {self.spec.addr!r}: {' '.join(str(error).split())}"
            if not self.spec.addr:
                problem = f"{with_article(self.spec.kind)} needs addr: a topic, service or action, such as /camera"
            raise InvalidRequest(f"interface {self.spec.tag}: {problem}", field="addr") from None
        except OSError as error:  # each ROS entity needs file descriptors
            problem = f"the environment has too many interfaces ({error.strerror})"
            raise LimitExceeded(f"interface {self.spec.tag}: {problem}: remove some first") from None

    def _report_once(self, error: RceError) -> None:
        """Log and report an error, unless the same text was reported before."""
        if str(error) not in self._reported and len(self._reported) < MAX_REPORTED:
            self._reported.add(str(error))
            log.warn("{owner} {tag}: {error}", owner=self.spec.owner, tag=self.spec.tag, error=str(error))
            self._context.report(self.spec, error)

    def _report_from_ros(self, kind: type[RceError], reason: str) -> None:
        """Report an error once."""
        self._report_once(kind(f"interface {self.spec.tag}: {reason}"))


def as_bytes(payload: Any) -> bytes:
    """Return a payload as bytes, copied only if it is of another type."""
    return payload if isinstance(payload, bytes) else bytes(payload)
