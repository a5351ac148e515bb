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
    """Interface that subscribes to a topic."""

    spec: InterfaceSpec

    def receive_shared(self, message: Message, link: Link, latched: bool) -> None:
        """Pass a message on to the peers of the interface.

        Args:
            message: A message that another interface publishes.
            link: The link on which it came.
            latched: Whether robots that come later get it.
        """


class SharedTopics:
    """Interfaces that subscribe, by the names of their topics and types."""

    def __init__(self) -> None:
        self._receivers: dict[tuple[str, str], list[Receiver]] = {}

    def add(self, receiver: Receiver) -> None:
        """Let an interface receive what is published on its topic."""
        self._receivers.setdefault(_key(receiver.spec), []).append(receiver)

    def remove(self, receiver: Receiver) -> None:
        """Undo `add`, if it was called."""
        receivers = self._receivers.get(_key(receiver.spec), [])
        if receiver in receivers:
            receivers.remove(receiver)
        if not receivers:
            self._receivers.pop(_key(receiver.spec), None)

    def has_receivers(self, spec: InterfaceSpec) -> bool:
        """Return whether an interface subscribes to the topic of the interface `spec`."""
        return _key(spec) in self._receivers

    def publish(self, spec: InterfaceSpec, message: Message, link: Link, latched: bool) -> None:
        """Pass a message of the interface `spec` to all that subscribe to its topic."""
        for receiver in self._receivers.get(_key(spec), ()):
            receiver.receive_shared(message, link, latched)


def _key(spec: InterfaceSpec) -> tuple[str, str]:
    return "/" + spec.addr.lstrip("/"), spec.type.replace("/msg/", "/")
