"""Parts of ROS 2 actions as bytes: names, goal ids in messages, and subscriptions.

An action NAME consists of the services and topics `NAME/_action/…` (design.ros2.org/articles/actions.html). Requests
and feedback begin with the goal's UUID. Its 16 bytes do not change the alignment of what follows them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from endpoints.data.frames import Buffer
from endpoints.environment.ros import Ros

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
    """Subscription to the feedback or the status of all goals of an action; `taken` gets the serialized messages."""

    def __init__(self, ros: Ros, kind: type[Any], name: str, qos: QoSProfile, taken: Callable[[bytes], None]) -> None:
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
        self._destroyed = False
        self._messages = ros.listen(self._take, self._subscription.handle)

    def _take(self) -> None:
        for _ in range(MAX_BATCH):
            if self._destroyed or not self._take_one():
                return
        self._messages.again()

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
        self._destroyed = True
        self._ros.end(self._messages)
        self._ros.node.destroy_subscription(self._subscription)
