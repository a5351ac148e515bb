"""A robot: its session with the platform, its commands, and its ends of topics and services."""

from __future__ import annotations

import logging
import ssl as tls
from collections.abc import Awaitable, Callable, Iterable, Mapping
from types import TracebackType
from typing import Any, Self, TypeVar, Unpack

from rce.client.address import Address
from rce.client.commands import Declared
from rce.client.connection import Connection, Message
from rce.client.environment import Environment
from rce.client.events import Disconnected, Event, Reconnected
from rce.client.interface import Interface
from rce.client.operations import EnvironmentOptions, Format, Operations
from rce.client.services import ServiceClient, ServiceProvider
from rce.client.session import Session
from rce.client.stream import Stream
from rce.client.topics import Publisher, Subscriber
from rce.errors import AlreadyExists, RceError
from rce.messages import (
    AddInterface,
    Command,
    FrameId,
    InterfaceStatus,
    Qos,
    StatusData,
)
from rce.names import check_robot, check_tag

EVENTS = 1000  # that one reader may leave unread

I = TypeVar("I", bound=Interface)  # noqa: E741

log = logging.getLogger("rce.client")


class Robot(Operations):
    """A robot at the platform whose entry is at `url`.

    Use it as `async with Robot(…) as robot`. It stays connected by itself: when the socket breaks it comes back, takes
    its interfaces and connections over or declares them again, and repeats the commands that were under way.
    """

    def __init__(
        self,
        url: str,
        *,
        user: str,
        robot: str,
        password: str | None = None,
        key: str | None = None,
        timeout: float = 60.0,
        compress: bool = False,
        ssl: tls.SSLContext | None = None,
        owner: str = "",
    ) -> None:
        """`password` in clear or an API `key`; `timeout` in seconds is for each command; `ssl` for own certificates.

        `compress` deflates all messages both ways, for lines that are slower than that. One whose name begins with `@`
        is a guest, for as long as it is connected: it takes part in the data of `owner`, the user's own if empty.
        """
        check_tag(user, "user")
        self.name = check_robot(robot, "robot")
        session = Session(Address(url, user, robot, password, key, compress, ssl, owner), self, timeout)
        super().__init__(session, Declared(robot))
        self._interfaces: dict[str, Interface] = {}
        self._readers: set[Stream[Event]] = set()

    async def __aenter__(self) -> Self:
        await self.open()
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def open(self) -> None:
        """Connect. Raises Unauthorized, Forbidden, Unavailable, InvalidRequest, AlreadyExists (for a name in use)."""
        await self._session.open()

    async def close(self) -> None:
        """Send what is queued and leave. Environments stay until they are destroyed."""
        await self._session.close()

    @property
    def connection(self) -> Connection | None:
        """None while the robot is not connected."""
        return self._session.connection

    @property
    def connected(self) -> bool:
        return self.connection is not None

    @property
    def features(self) -> frozenset[str]:
        """What the server granted: none means an original server, whose commands end when they are sent."""
        return self.connection.features if self.connection is not None else frozenset()

    def events(self) -> Stream[Event]:
        """What happens from now on; read it with `async for`. Every call gives a stream of its own."""
        stream: Stream[Event] = Stream(EVENTS)
        self._readers.add(stream)
        return stream

    def environment(self, tag: str, **options: Unpack[EnvironmentOptions]) -> Environment:
        """The environment of that tag, by which its topics and services are used.

        `async with robot.environment(…)` creates it with these options and destroys it at the end.
        """
        return Environment(self, tag, options)

    # --- the robot's ends of topics and services

    async def remove_interface(self, endpoint: str, tag: str) -> None:
        """Remove an interface and its connections."""
        if endpoint == self.name and tag in self._interfaces:
            self._interfaces.pop(tag).ended(None)
        await super().remove_interface(endpoint, tag)

    async def publisher(
        self,
        tag: str,
        type_name: str,
        *,
        to: str = "",
        raw: bool = False,
        format: Format = "png",
        qos: Qos | None = None,
    ) -> Publisher:
        """An interface that sends messages; `to` is the `endpoint/interface` that takes them, connected at once.

        `raw` messages are the bytes of the serialized ROS message (CDR), else they are dicts. `format` is for images;
        of `qos`, history and depth are for the queue at the platform.
        """
        return await self._add(Publisher(self, tag, type_name), "Subscriber", to, raw, format, qos)

    async def subscriber(
        self,
        tag: str,
        type_name: str,
        *,
        to: str = "",
        callback: Callable[[Any], Awaitable[None] | None] | None = None,
        depth: int = 10,
        raw: bool = False,
        format: Format = "png",
        qos: Qos | None = None,
    ) -> Subscriber:
        """An interface that receives messages of the interface `to`; see `Subscriber`."""
        subscriber = Subscriber(self, tag, type_name, depth)
        if callback is not None:
            subscriber.call(callback)
        return await self._add(subscriber, "Publisher", to, raw, format, qos)

    async def service_client(self, tag: str, type_name: str, *, to: str = "", raw: bool = False) -> ServiceClient:
        """An interface that calls the service of the interface `to`."""
        return await self._add(ServiceClient(self, tag, type_name), "ServiceProvider", to, raw)

    async def service_provider(
        self, tag: str, type_name: str, handler: Callable[[Any], Any], *, to: str = "", raw: bool = False
    ) -> ServiceProvider:
        """An interface that answers the calls of the interface `to` with what `handler` (plain or async) returns."""
        return await self._add(ServiceProvider(self, tag, type_name, handler), "ServiceClient", to, raw)

    async def _add(
        self, interface: I, kind: str, to: str, raw: bool, format: Format = "png", qos: Qos | None = None
    ) -> I:
        """Add the interface and connect it; when that fails it is as if it had never been."""
        tag = interface.tag
        if tag in self._interfaces:
            raise AlreadyExists(f"{self.name}/{tag} exists already: close it first or use another tag")
        self._interfaces[tag] = interface
        kind += "Forwarder" if raw else "Converter"
        try:
            await self.configure(
                AddInterface(self.name, tag, kind, interface.type_name, qos=qos or Qos(), format=format)
            )
        except RceError:
            self._interfaces.pop(tag).ended(None)
            raise
        if to:
            try:
                await self.connect(to, f"{self.name}/{tag}")
                await interface.wait_connected()
            except RceError:
                await interface.close()
                raise
        return interface

    # --- what the session tells

    def received(self, message: Message) -> None:
        interface = self._interfaces.get(message.data.iTag)
        if interface is None:
            log.debug("a message of the unknown interface %s", message.data.iTag)
            return
        try:
            interface.received(message)
        except RceError as error:
            self.failed(error, None)

    def status(self, status: StatusData) -> None:
        if isinstance(status, InterfaceStatus):
            if status.iTag in self._interfaces:
                self._interfaces[status.iTag].status(status.status)
        else:
            self._tell(status)  # type: ignore[arg-type]

    def failed(self, error: RceError, frame_id: FrameId | None) -> None:
        call = error.info.fields.get("msgID")
        if call is not None and any(each.failed(error, str(call)) for each in self._interfaces.values()):
            return
        log.warning("%s: %s", self.name, error)
        self._tell(error)

    def lost(self, reason: str) -> None:
        log.warning("%s: the connection broke (%s); connecting again", self.name, reason)
        for interface in self._interfaces.values():
            interface.lost()
        self._tell(Disconnected(reason))

    def back(self, resumed: bool, interfaces: Mapping[str, bool]) -> None:
        for interface in self._interfaces.values():
            interface.back(interfaces.get(interface.tag, False))
        self._tell(Reconnected(resumed))

    def declared(self) -> Iterable[Command]:
        return self._declared.commands()

    def ended(self, error: RceError | None) -> None:
        for interface in self._interfaces.values():
            interface.ended(error)
        for reader in self._readers:
            reader.end(error)

    def _tell(self, event: Event) -> None:
        for reader in self._readers:
            reader.put(event)
