"""Distribution of what a session receives to the robot's interfaces and to the readers of its events."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterable, Mapping
from weakref import WeakSet

from rce.client.connection import Message
from rce.client.declarations import Declarations
from rce.client.events import Disconnected, Event, PlatformEvent, Reconnected
from rce.client.interface import Interface
from rce.client.stream import Stream
from rce.errors import RceError
from rce.protocol.messages import Command, ConnectionEvent, InterfaceStatus

EVENT_BACKLOG = 1000  # unread events that one reader may have
EARLY = 1000  # newest messages and statuses that are kept for the interfaces of a service

log = logging.getLogger("rce.client")


class Dispatcher:
    """Listener of one robot's session.

    Attributes:
        interfaces: The robot's interfaces by tag.
    """

    def __init__(self, robot: str, declarations: Declarations) -> None:
        self.interfaces: dict[str, Interface] = {}
        self._robot = robot
        self._declarations = declarations
        self._early: dict[str, deque[Message | InterfaceStatus]] = {}  # for interfaces to come, by the prefix of tags
        self._readers: WeakSet[Stream[Event]] = WeakSet()  # a stream that nobody reads any more is forgotten
        self._ended = False
        self._error: RceError | None = None

    def events(self) -> Stream[Event]:
        """Return a new stream of the events from now on."""
        stream: Stream[Event] = Stream(EVENT_BACKLOG)
        self._readers.add(stream)
        if self._ended:
            stream.end(self._error)
        return stream

    def message_received(self, message: Message) -> None:
        """Give a data message to its interface."""
        interface = self.interfaces.get(message.data.iTag)
        if interface is None and self._keep(message.data.iTag, message):
            return
        if interface is None:
            log.debug("%s: dropped a message for the unknown interface %s", self._robot, message.data.iTag)
            return
        try:
            interface._receive(message)
        except RceError as error:
            self.error_received(error)

    def status_received(self, status: InterfaceStatus | PlatformEvent) -> None:
        """Apply an interface's status, or publish any other status as an event."""
        if isinstance(status, InterfaceStatus):
            if status.iTag in self.interfaces:
                self.interfaces[status.iTag]._set_status(status.status)
            else:
                self._keep(status.iTag, status)
            return
        if isinstance(status, ConnectionEvent) and status.state == "gone":
            self._declarations.connection_gone(status.tagA, status.tagB)
        self._publish(status)

    def error_received(self, error: RceError) -> None:
        """Fail the service call that the error answers, or publish it as an event."""
        msg_id = error.info.fields.get("msgID")
        if msg_id is not None and any(each._fail_call(error, str(msg_id)) for each in self.interfaces.values()):
            return
        interface = self.interfaces.get(str(error.info.fields.get("iTag", "")))
        if interface is not None and interface._refused(error):
            return
        log.warning("%s: %s", self._robot, error)
        self._publish(error)

    def disconnected(self, reason: str) -> None:
        """Tell interfaces and readers that the socket broke."""
        log.warning("%s: the connection broke (%s); reconnecting", self._robot, reason)
        for interface in self.interfaces.values():
            interface._disconnected()
        self._publish(Disconnected(reason))

    def reconnected(self, resumed: bool, interfaces: Mapping[str, bool]) -> None:
        """Apply the interface statuses of the new connection."""
        for interface in self.interfaces.values():
            interface._set_status(interfaces.get(interface.tag, False))
        self._publish(Reconnected(resumed))

    def declarations(self) -> Iterable[Command]:
        """Return the commands that restore the robot's interfaces and connections."""
        return self._declarations.commands()

    def ended(self, error: RceError | None) -> None:
        """End all interfaces and event streams."""
        self._ended, self._error = True, error
        for interface in self.interfaces.values():
            interface._end(error)
        for reader in self._readers:
            reader.end(error)

    def expect(self, prefix: str) -> None:
        """Keep what comes for interfaces whose tags begin with `prefix`, which the platform makes."""
        self._early.setdefault(prefix, deque(maxlen=EARLY))

    def adopt(self, prefix: str, interfaces: Iterable[Interface]) -> None:
        """Add connected interfaces, give them what came before, and expect no more of this prefix."""
        for interface in interfaces:
            self.interfaces[interface.tag] = interface
            interface._set_status(True)
        for each in self._early.pop(prefix, ()):
            if isinstance(each, InterfaceStatus):
                self.status_received(each)
            else:
                self.message_received(each)

    def _keep(self, tag: str, item: Message | InterfaceStatus) -> bool:
        kept = next((kept for prefix, kept in self._early.items() if tag.startswith(prefix)), None)
        if kept is not None:
            kept.append(item)
        return kept is not None

    def _publish(self, event: Event) -> None:
        for reader in self._readers:
            reader.put(event)
