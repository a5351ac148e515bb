"""Topics that interfaces of one environment share: what one of them publishes, the others receive.

ROS does not bring a process its own messages (`RawSubscription` ignores them, since they would come with delay and only
while a node subscribes), so they are passed on here.
"""

from __future__ import annotations

from typing import Protocol

from endpoints.data.frames import Message
from endpoints.data.link import Link
from rce.control.calls.endpoints import InterfaceSpec


class Receiver(Protocol):
    """Subscription to a topic."""

    spec: InterfaceSpec

    def receive_shared(self, message: Message, link: Link, latched: bool) -> None:
        """Pass a message on to the peers of all interfaces that share the subscription.

        Args:
            message: A message that another interface publishes.
            link: The link on which it came.
            latched: Whether robots that come later get it.
        """


class SharedTopics:
    """Subscriptions by the names of their topics and types."""

    def __init__(self) -> None:
        self._receivers: dict[tuple[str, str], list[Receiver]] = {}

    def add(self, receiver: Receiver) -> None:
        """Let a subscription receive what is published on its topic."""
        self._receivers.setdefault(topic_key(receiver.spec), []).append(receiver)

    def remove(self, receiver: Receiver) -> None:
        """Undo `add`, if it was called."""
        receivers = self._receivers.get(topic_key(receiver.spec), [])
        if receiver in receivers:
            receivers.remove(receiver)
        if not receivers:
            self._receivers.pop(topic_key(receiver.spec), None)

    def receivers_of(self, spec: InterfaceSpec) -> list[Receiver]:
        """Return what receives from the topic of the interface `spec`."""
        return self._receivers.get(topic_key(spec), [])

    def has_receivers(self, spec: InterfaceSpec) -> bool:
        """Return whether somebody subscribes to the topic of the interface `spec`."""
        return topic_key(spec) in self._receivers

    def publish(self, spec: InterfaceSpec, message: Message, link: Link, latched: bool) -> None:
        """Pass a message of the interface `spec` to all that subscribe to its topic."""
        for receiver in self._receivers.get(topic_key(spec), ()):
            receiver.receive_shared(message, link, latched)


def topic_key(spec: InterfaceSpec) -> tuple[str, str]:
    """Return the topic and the type of an interface, in one spelling."""
    return "/" + spec.addr.lstrip("/"), spec.type.replace("/msg/", "/")
