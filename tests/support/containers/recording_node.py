"""Stand-in for a node of rclpy that records what a part of a node does with it: no time, no network."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any


class RecordingPublisher:
    """Publisher that keeps its messages."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.subscribers = 0

    def publish(self, message: Any) -> None:
        self.sent.append(message)

    def get_subscription_count(self) -> int:
        return self.subscribers


class RecordingNode:
    """Node that keeps its publishers, and the callbacks of its subscriptions and timers, for the test to call.

    Attributes:
        publishers: By topic.
        subscriptions: By topic; each has `callback`, `qos_profile` and `events`.
        timers: Callbacks of timers.
        logged: Messages that were logged.
    """

    def __init__(self, **parameters: object) -> None:
        self._parameters = parameters
        self.publishers: dict[str, RecordingPublisher] = {}
        self.subscriptions: dict[str, Any] = {}
        self.timers: list[Callable[[], None]] = []
        self.logged: list[str] = []

    def sent(self, topic: str) -> list[Any]:
        """Return the messages published on a topic."""
        return self.publishers[topic].sent

    def receive(self, topic: str, message: Any) -> None:
        """Let a message arrive on a topic."""
        self.subscriptions[topic].callback(message)

    def create_publisher(self, _kind: Any, topic: str, _qos: Any) -> RecordingPublisher:
        self.publishers[topic] = RecordingPublisher()
        return self.publishers[topic]

    def create_subscription(
        self, _kind: Any, topic: str, callback: Any, qos: Any, event_callbacks: Any = None
    ) -> SimpleNamespace:
        made = SimpleNamespace(topic=topic, callback=callback, qos_profile=qos, events=event_callbacks)
        self.subscriptions[topic] = made
        return made

    def destroy_subscription(self, subscription: SimpleNamespace) -> None:
        del self.subscriptions[subscription.topic]

    def create_timer(self, _seconds: float, callback: Callable[[], None]) -> None:
        self.timers.append(callback)

    def get_parameter(self, name: str) -> SimpleNamespace:
        return SimpleNamespace(value=self._parameters[name])

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(info=self.logged.append, warning=self.logged.append, error=self.logged.append)
