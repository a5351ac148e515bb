"""Interfaces on a robot: Publisher, Subscriber, ServiceClient, ServiceProvider, each as Converter or Forwarder.

Names are from the cloud's point of view: to a `Publisher` of the robot the cloud's messages come in and go out to the
robot; a `ServiceClient` asks the robot. A Converter turns JSON into CDR and back, a Forwarder carries CDR bytes.
"""

from __future__ import annotations

import asyncio
import itertools
import uuid
from collections.abc import Iterator
from time import perf_counter
from typing import Literal, Protocol, cast

import msgspec
from msgspec import UNSET

from converters.types import TypeRegistry
from converters.wire import Wire
from endpoints.frames import Message
from endpoints.hops import Watch
from endpoints.interface import Interface, error_of
from endpoints.link import Link
from endpoints.robot.session import Piece, Session
from rce.blobs import Buffer, binary_frames
from rce.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, LimitExceeded, NotConnected, RceError, TimedOut
from rce.messages import MAX_MSG_ID, DataMessage
from rce.names import parse_type

MAX_PENDING = 1000  # service calls of one interface that wait for an answer


class Codec(Protocol):
    """Between what a robot sends and CDR."""

    def encode(self, wire: Wire) -> Buffer: ...

    def decode(self, cdr: Buffer) -> Wire: ...


class Untouched:
    """The codec of Forwarders: the blob is the CDR."""

    def encode(self, wire: Wire) -> Buffer:
        if not wire.whole or len(wire.blobs) != 1:
            raise InvalidRequest(
                "a Forwarder takes its message as one blob: write msg* with the blob's id", field="msg"
            )
        return next(iter(wire.blobs.values()))

    def decode(self, cdr: Buffer) -> Wire:
        name = uuid.uuid4().hex
        return Wire(True, b'"%b"' % name.encode(), {name: cdr})


class RobotInterface(Interface):
    """What the four kinds share: the robot's session and the form of its data messages."""

    def __init__(self, spec: InterfaceSpec, watch: Watch, session: Session) -> None:
        super().__init__(spec, watch)
        self.session = session
        self._type = parse_type(spec.type)
        quoted = msgspec.json.encode({"iTag": spec.tag, "type": spec.type})[:-1]
        self._head = b'{"type":"DM","data":' + quoted + b',"msgID":'
        session.interfaces[spec.tag] = self

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        """Take a data message that the robot sent. Raises what the robot shall hear."""
        raise NotImplementedError

    def started(self) -> None:
        self.session.interface_status(self.spec.tag, True)

    def stopped(self) -> None:
        self.session.interface_status(self.spec.tag, False)

    def close(self) -> None:
        self.session.outbox.forget(self.id)
        if self.session.interfaces.get(self.spec.tag) is self:  # a later one may have its tag already
            del self.session.interfaces[self.spec.tag]

    def wire(self, message: DataMessage, blobs: dict[str, Buffer]) -> Wire:
        """The payload of a data message, its type and id checked."""
        if message.type != self.spec.type and parse_type(message.type) != self._type:
            raise InvalidRequest(f"{self.spec.tag} has type {self.spec.type}, not {message.type[:80]}", field="type")
        if len(message.msgID.encode()) > MAX_MSG_ID:
            raise InvalidRequest(f"msgID is longer than {MAX_MSG_ID} bytes", field="msgID")
        if message.blob is not UNSET:
            return Wire(True, message.blob, blobs)
        if message.msg is UNSET:
            raise InvalidRequest("a data message needs msg or msg*", field="msg")
        return Wire(False, message.msg, blobs)

    def to_robot(self, codec: Codec, msg_id: str, message: Message, keep: int | None) -> None:
        """Queue a data message for the robot; it is converted when it leaves, so what is dropped costs nothing."""
        dropped = self.session.outbox.put(self.id, self._pieces(codec, msg_id, message), keep)
        if dropped:
            self.dropped += dropped
            self.session.dropped(self.spec.tag, self.dropped, "on the way to the robot")

    def _pieces(self, codec: Codec, msg_id: str, message: Message) -> Iterator[Piece]:
        try:
            wire = codec.decode(message.payload)
        except RceError as error:
            yield self.session.error_piece(error.at(self.spec.tag))
            return
        key = b',"msg*":' if wire.whole else b',"msg":'
        text = b"".join((self._head, msgspec.json.encode(msg_id), key, cast(bytes, wire.raw), b"}}"))
        parts = self.session.parts
        frames = binary_frames(wire.blobs, parts)
        if parts:
            yield [text]
            yield from ([frame] for frame in frames)
        else:  # one after the other, as old clients expect
            yield [text, *frames]
        self.watch.ended(self.id, message)

    def count_drops(self) -> None:
        """Tell the robot if the link dropped messages of this interface since last time."""
        if self.dropped:
            self.session.dropped(self.spec.tag, self.dropped, "on the way from the robot")


class Publisher(RobotInterface):
    """Messages of a topic to the robot."""

    def __init__(self, spec: InterfaceSpec, watch: Watch, session: Session, codec: Codec) -> None:
        super().__init__(spec, watch, session)
        self._codec = codec

    def receive(self, message: Message, link: Link) -> None:
        self.to_robot(self._codec, message.msg_id, message, self.keep)
        if self.keep is None and (room := self.session.outbox.room(self.id)) is not None:
            link.pause(room)

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        raise InvalidRequest(
            f"{self.spec.tag} is a {self.spec.kind}: messages come out of it, none go in", field="iTag"
        )


class Subscriber(RobotInterface):
    """Messages of a topic from the robot."""

    def __init__(self, spec: InterfaceSpec, watch: Watch, session: Session, codec: Codec) -> None:
        super().__init__(spec, watch, session)
        self._codec = codec

    def receive(self, message: Message, link: Link) -> None:
        """Nothing comes this way."""

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        since = perf_counter()
        payload = self._codec.encode(self.wire(message, blobs))
        before = self.dropped
        try:
            self.send(Message(self.id, message.msgID, payload, since=since))
        except NotConnected:
            if self.session.features:
                raise
            return  # as the original did: its clients go on publishing when a peer is gone
        if self.dropped != before:
            self.count_drops()
        if (room := self.room()) is not None:
            self.session.hold(room)


class ServiceInterface(RobotInterface):
    """What both sides of a service share: the calls that wait for an answer, and how long they may."""

    def __init__(
        self,
        spec: InterfaceSpec,
        watch: Watch,
        session: Session,
        request: Codec,
        response: Codec,
        timeout: float,
    ) -> None:
        super().__init__(spec, watch, session)
        self._request = request
        self._response = response
        self._timeout = timeout
        self._waiting: dict[str, tuple[Message, asyncio.TimerHandle]] = {}

    def late(self, call: Message) -> None:
        """No answer came in time."""
        raise NotImplementedError

    def parted(self, call: Message) -> None:
        """The last peer is gone before the answer came."""
        raise NotImplementedError

    def _await(self, name: str, call: Message) -> None:
        """Raises LimitExceeded when too many calls wait already."""
        if len(self._waiting) >= MAX_PENDING:
            raise LimitExceeded(f"{self.spec.tag}: {MAX_PENDING} calls wait already")
        timer = asyncio.get_running_loop().call_later(self._timeout, self._expire, name)
        self._waiting[name] = (call, timer)

    def _take(self, name: str) -> Message | None:
        """The call of this name, which waits no more; None if it does not wait."""
        call, timer = self._waiting.pop(name, (None, None))
        if timer is not None:
            timer.cancel()
        return call

    def _expire(self, name: str) -> None:
        call = self._take(name)
        if call is not None:
            self.late(call)

    def stopped(self) -> None:
        super().stopped()
        for name in list(self._waiting):
            call = self._take(name)
            if call is not None:
                self.parted(call)


class ServiceClient(ServiceInterface):
    """The cloud asks, the robot answers."""

    def receive(self, message: Message, link: Link) -> None:
        name = uuid.uuid4().hex
        try:
            self._await(name, message)
        except LimitExceeded as error:
            self.fail(message, error)
            return
        self.to_robot(self._request, name, message, None)

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        since = perf_counter()
        request = self._take(message.msgID)
        if request is None:
            raise NotConnected(
                f"{self.spec.tag}: no call with msgID {message.msgID[:64]!r} waits (any more)", field="msgID"
            )
        if message.error:
            self.fail(request, RceError(f"{self.spec.owner}/{self.spec.tag}: {message.error}"))
            return
        try:
            payload = self._response.encode(self.wire(message, blobs))
        except RceError as error:
            self.fail(request, error)
            raise
        self.request(Message(self.id, request.msg_id, payload, destination=request.source, since=since))

    def late(self, call: Message) -> None:
        self.fail(call, TimedOut(f"robot {self.spec.owner} did not answer within {self._timeout:g} s"))

    def parted(self, call: Message) -> None:
        """Whoever asked is gone."""


class ServiceProvider(ServiceInterface):
    """The robot asks, the cloud answers."""

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        if message.msgID in self._waiting:
            raise InvalidRequest(f"{self.spec.tag}: a call with this msgID waits already", field="msgID")
        since = perf_counter()
        payload = self._request.encode(self.wire(message, blobs))
        # Before the request leaves: within this process it may fail at once.
        self._await(message.msgID, Message(self.id, message.msgID, b""))
        try:
            self.request(Message(self.id, message.msgID, payload, since=since))
        except RceError:
            self._take(message.msgID)
            raise

    def receive(self, message: Message, link: Link) -> None:
        if self._take(message.msg_id) is None:
            return  # it came too late: the robot has been told
        if message.error:
            self._fail(message, error_of(message))
        else:
            self.to_robot(self._response, message.msg_id, message, None)

    def late(self, call: Message) -> None:
        self._fail(call, TimedOut(f"no answer from the service within {self._timeout:g} s"))

    def parted(self, call: Message) -> None:
        self._fail(call, NotConnected(f"{self.spec.tag} lost its connection before the answer came"))

    def _fail(self, call: Message, error: RceError) -> None:
        self.session.call_failed(self.spec.tag, call.msg_id, error)


def make(spec: InterfaceSpec, watch: Watch, session: Session, types: TypeRegistry, timeout: float) -> RobotInterface:
    """The interface of this kind. UnknownType if a Converter's type is not known."""
    prefix = spec.kind.removesuffix("Converter").removesuffix("Forwarder")
    forward = spec.kind.endswith("Forwarder")
    name = parse_type(spec.type)
    if prefix in ("Publisher", "Subscriber"):
        image = cast(Literal["png", "jpeg", "json"], spec.format)
        codec: Codec = Untouched() if forward else types.message(name, image)
        return (Publisher if prefix == "Publisher" else Subscriber)(spec, watch, session, codec)
    request, response = itertools.repeat(Untouched(), 2) if forward else types.service(name)
    kind = ServiceClient if prefix == "ServiceClient" else ServiceProvider
    return kind(spec, watch, session, request, response, timeout)
