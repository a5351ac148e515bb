"""Parts of ROS 2 actions as bytes: names, goal ids in messages, and subscriptions.

An action NAME consists of the services and topics `NAME/_action/…` (design.ros2.org/articles/actions.html). Requests
and feedback begin with the goal's UUID. Its 16 bytes do not change the alignment of what follows them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from endpoints.data.frames import Buffer
from endpoints.environment.ros import RosThread

HEADER = b"\0\1\0\0"  # of CDR, little endian
MAX_BATCH = 16  # messages taken of one entity before others have their turn
FEEDBACK_QOS = QoSProfile(depth=100)
STATUS_QOS = QoSProfile(depth=1, durability=QoSDurabilityPolicy.TRANSIENT_LOCAL)  # as action servers of ROS


def part_of(action: str, part: str) -> str:
    """Return the name of a service or topic of an action, as `send_goal`."""
    return f"{action}/_action/{part}"


def with_goal_id(payload: Buffer, id: str) -> bytes:
    """Return a goal or feedback with the goal's id before it."""
    return bytes(payload[:4]) + bytes.fromhex(id) + bytes(payload[4:])


def without_goal_id(payload: bytes) -> tuple[str, bytes]:
    """Return the goal's id, and what comes after it as a message of its own."""
    return payload[4:20].hex(), payload[:4] + payload[20:]


class ActionTopic:
    """Subscription to the feedback or the status of all goals of an action; `taken` gets the serialized messages.

    All methods run in the ROS thread.
    """

    clients = services = events = 0
    subscriptions = 1

    def __init__(
        self, ros: RosThread, kind: type[Any], name: str, qos: QoSProfile, taken: Callable[[bytes], None]
    ) -> None:
        self._ros = ros
        self._kind = kind
        self._taken = taken
        self._subscription: Subscription[Any] = ros.node.create_subscription(
            kind,
            name,
            lambda message: None,
            qos,
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )
        ros.add_waitable(self)

    def add(self, wait_set: _rclpy.WaitSet) -> None:
        """Add the subscription to the wait set."""
        self._index = wait_set.add_subscription(self._subscription.handle)

    def take(self, wait_set: _rclpy.WaitSet) -> None:
        """Take the messages that have come."""
        if wait_set.is_ready("subscription", self._index):
            for _ in range(MAX_BATCH):
                if not self._take_one():
                    return

    def take_all(self) -> None:
        """Take the messages that have come, before something that came after them is processed."""
        while self._take_one():
            pass

    def _take_one(self) -> bool:
        found = self._subscription.handle.take_message(self._kind, True)
        if found is not None:
            self._taken(bytes(found[0]))
        return found is not None

    def destroy(self) -> None:
        """Destroy the subscription."""
        self._ros.node.destroy_subscription(self._subscription)
