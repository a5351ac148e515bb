"""Interfaces of a robot: Publisher, Subscriber, ServiceClient and ServiceProvider, each as Converter or Forwarder.

Names are from the cloud's point of view: a `Publisher` sends the cloud's messages to the robot, a `ServiceClient` calls
a service of the robot. A Converter converts between JSON and CDR, a Forwarder passes CDR through.
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
from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import Interface, error_of
from endpoints.data.link import Link
from endpoints.robot.session import Piece, RobotSession
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, LimitExceeded, NotConnected, RceError, TimedOut
from rce.net.budget import OVERHEAD
from rce.protocol.blobs import Buffer, binary_frames
from rce.protocol.messages import MAX_MSG_ID, DataMessage
from rce.protocol.names import parse_type

MAX_PENDING = 1000  # unanswered service calls of one interface


class Codec(Protocol):
    """Conversion between the robot's representation of a message and CDR."""

    def encode(self, wire: Wire) -> Buffer:
        """Convert a message of the robot to CDR; raise ConversionError if it does not fit its type."""

    def decode(self, cdr: Buffer) -> Wire:
        """Convert CDR to a message for the robot."""


class PassThroughCodec:
    """Codec of Forwarders, for which the blob of a message is its CDR."""

    def encode(self, wire: Wire) -> Buffer:
        """Return the blob of a message; raise InvalidRequest if it is not exactly one blob."""
        if not wire.is_blob or len(wire.blobs) != 1:
            raise InvalidRequest(
                "the message of a Forwarder must be one blob: send msg* with the blob's id", field="msg"
            )
        return next(iter(wire.blobs.values()))

    def decode(self, cdr: Buffer) -> Wire:
        """Return the CDR as a blob with a new id."""
        name = uuid.uuid4().hex
        return Wire(True, b'"%b"' % name.encode(), {name: cdr})


class RobotInterface(Interface):
    """Base of the four kinds: holds the robot's session and encodes data messages for it."""

    way = "from the robot"  # on which messages may be dropped

    def __init__(self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession) -> None:
        super().__init__(spec, hops, session.budget)
        self.session = session
        self._type = parse_type(spec.type)
        quoted = msgspec.json.encode({"iTag": spec.tag, "type": spec.type})[:-1]
        self._head = b'{"type":"DM","data":' + quoted + b',"msgID":'
        session.interfaces[spec.tag] = self

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        """Handle a data message of the robot; errors raised are sent to the robot."""
        raise NotImplementedError

    def started(self) -> None:
        """Tell the robot that the interface has a peer."""
        self.session.interface_status(self.spec.tag, True)

    def stopped(self) -> None:
        """Tell the robot that the interface has no peer any more."""
        self.session.interface_status(self.spec.tag, False)

    def close(self) -> None:
        """Drop the waiting messages and remove the interface from its session."""
        self.session.outbox.discard(self.id)
        if self.session.interfaces.get(self.spec.tag) is self:  # its tag may belong to a newer interface already
            del self.session.interfaces[self.spec.tag]

    def wire(self, message: DataMessage, blobs: dict[str, Buffer]) -> Wire:
        """Return the payload of a data message; raise InvalidRequest if its type or id is wrong."""
        if message.type != self.spec.type and parse_type(message.type) != self._type:
            raise InvalidRequest(
                f"interface {self.spec.tag} has type {self.spec.type}, not {message.type[:80]}", field="type"
            )
        if len(message.msgID.encode()) > MAX_MSG_ID:
            raise InvalidRequest(f"msgID is longer than {MAX_MSG_ID} bytes", field="msgID")
        if message.blob is not UNSET:
            return Wire(True, message.blob, blobs)
        if message.msg is UNSET:
            raise InvalidRequest("a data message needs msg or msg*", field="msg")
        return Wire(False, message.msg, blobs)

    def to_robot(self, codec: Codec, msg_id: str, message: Message, keep: int | None) -> None:
        """Queue a data message for the robot.

        The message is converted when it leaves the queue, so a dropped message costs no conversion.
        """
        size = len(message.payload) + OVERHEAD
        dropped = self.session.outbox.put(self.id, self._pieces(codec, msg_id, message), keep, size, self)
        if dropped:
            self.dropped += dropped
            self.report_drops()

    def _pieces(self, codec: Codec, msg_id: str, message: Message) -> Iterator[Piece]:
        try:
            wire = codec.decode(message.payload)
        except RceError as error:
            yield self.session.error_piece(error.with_item(self.spec.tag))
            return
        key = b',"msg*":' if wire.is_blob else b',"msg":'
        text = b"".join((self._head, msgspec.json.encode(msg_id), key, cast(bytes, wire.raw), b"}}"))
        parts = self.session.parts
        frames = binary_frames(wire.blobs, parts)
        if parts:
            yield [text]
            yield from ([frame] for frame in frames)
        else:  # in one piece: old clients expect the blobs right after their frame
            yield [text, *frames]
        self.hops.delivered(self.id, message)

    def evicted(self, count: int) -> None:
        """Count and report messages that were dropped from a queue because a larger budget was exceeded."""
        super().evicted(count)
        self.report_drops()

    def report_drops(self) -> None:
        """Report to the robot the messages that were dropped."""
        self.session.dropped(self.spec.tag, self.dropped, f"on the way {self.way}")


class Publisher(RobotInterface):
    """Sends messages of a topic to the robot."""

    way = "to the robot"

    def __init__(self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, codec: Codec) -> None:
        super().__init__(spec, hops, session)
        self._codec = codec

    def receive(self, message: Message, link: Link) -> None:
        """Queue a message for the robot; with `keep_all`, pause the link while the queue is full."""
        self.to_robot(self._codec, message.msg_id, message, self.keep)
        if self.keep is None and (room := self.session.outbox.wait_for_room(self.id)) is not None:
            link.pause(room)

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        """Reject the message: this interface only sends to the robot."""
        raise InvalidRequest(
            f"interface {self.spec.tag} is a {self.spec.kind}: the robot receives from it and cannot send to it",
            field="iTag",
        )


class Subscriber(RobotInterface):
    """Receives messages of a topic from the robot."""

    def __init__(self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, codec: Codec) -> None:
        super().__init__(spec, hops, session)
        self._codec = codec

    def receive(self, message: Message, link: Link) -> None:
        """Ignore the message: this interface only receives from the robot."""

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        """Convert a message and send it to all peers; with `keep_all`, pause the robot while a link is full."""
        since = perf_counter()
        payload = self._codec.encode(self.wire(message, blobs))
        before = self.dropped
        try:
            self.send(Message(self.id, message.msgID, payload, entered_at=since))
        except NotConnected:
            if self.session.features:
                raise
            return  # clients of the original protocol go on publishing when a peer is gone
        if self.dropped != before:
            self.report_drops()
        if (room := self.wait_for_room()) is not None:
            self.session.pause_reading(room)


class ServiceInterface(RobotInterface):
    """Base of both sides of a service: keeps the unanswered calls and their timeouts."""

    def __init__(
        self,
        spec: InterfaceSpec,
        hops: HopRecorder,
        session: RobotSession,
        request: Codec,
        response: Codec,
        timeout: float,
    ) -> None:
        super().__init__(spec, hops, session)
        self._request = request
        self._response = response
        self._timeout = timeout
        self._waiting: dict[str, tuple[Message, asyncio.TimerHandle]] = {}

    def timed_out(self, call: Message) -> None:
        """Handle a call that was not answered in time."""
        raise NotImplementedError

    def peer_lost(self, call: Message) -> None:
        """Handle an unanswered call when the last peer is gone."""
        raise NotImplementedError

    def check_room(self) -> None:
        """Raise LimitExceeded if too many bytes wait for the robot to take another message."""
        if self.budget.full and self.session.outbox.backlog(self.id):
            raise LimitExceeded(
                f"interface {self.spec.tag}: too many bytes wait for robot {self.spec.owner} already: "
                "send fewer or smaller messages at a time"
            )

    def _add_call(self, name: str, call: Message) -> None:
        """Keep an unanswered call; raise LimitExceeded when there are too many."""
        if len(self._waiting) >= MAX_PENDING:
            raise LimitExceeded(f"interface {self.spec.tag} has {MAX_PENDING} unanswered calls: wait for their answers")
        timer = asyncio.get_running_loop().call_later(self._timeout, self._expire, name)
        self._waiting[name] = (call, timer)

    def _pop_call(self, name: str) -> Message | None:
        """Remove and return the unanswered call of this name; None if there is none."""
        call, timer = self._waiting.pop(name, (None, None))
        if timer is not None:
            timer.cancel()
        return call

    def _expire(self, name: str) -> None:
        call = self._pop_call(name)
        if call is not None:
            self.timed_out(call)

    def stopped(self) -> None:
        """Tell the robot that the interface has no peer any more, and end the unanswered calls."""
        super().stopped()
        for name in list(self._waiting):
            call = self._pop_call(name)
            if call is not None:
                self.peer_lost(call)


class ServiceClient(ServiceInterface):
    """Passes service calls from the cloud to the robot, which answers them."""

    def receive(self, message: Message, link: Link) -> None:
        """Send a request to the robot under a message id of its own."""
        name = uuid.uuid4().hex
        try:
            self.check_room()
            self._add_call(name, Message(message.source, message.msg_id, b""))  # the payload is not needed any more
        except LimitExceeded as error:
            self.fail(message, error)
            return
        self.to_robot(self._request, name, message, None)

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        """Send the robot's response, or its error, to the interface that made the call."""
        since = perf_counter()
        request = self._pop_call(message.msgID)
        if request is None:
            raise NotConnected(
                f"interface {self.spec.tag}: there is no unanswered call with msgID {message.msgID[:64]!r}; "
                "it may have timed out",
                field="msgID",
            )
        if message.error:
            self.fail(request, RceError(f"{self.spec.owner}/{self.spec.tag}: {message.error}"))
            return
        try:
            payload = self._response.encode(self.wire(message, blobs))
        except RceError as error:
            self.fail(request, error)
            raise
        self.request(Message(self.id, request.msg_id, payload, destination=request.source, entered_at=since))

    def timed_out(self, call: Message) -> None:
        """Answer the call with an error."""
        self.fail(call, TimedOut(f"robot {self.spec.owner} did not answer within {self._timeout:g} s"))

    def peer_lost(self, call: Message) -> None:
        """Do nothing: the interface that made the call is gone."""


class ServiceProvider(ServiceInterface):
    """Passes service calls from the robot to the cloud, which answers them."""

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> None:
        """Send a request of the robot to the service."""
        if message.msgID in self._waiting:
            raise InvalidRequest(
                f"interface {self.spec.tag} has an unanswered call with this msgID: use a new one", field="msgID"
            )
        since = perf_counter()
        payload = self._request.encode(self.wire(message, blobs))
        # Before the request leaves: a peer in this process may answer at once.
        self._add_call(message.msgID, Message(self.id, message.msgID, b""))
        try:
            self.request(Message(self.id, message.msgID, payload, entered_at=since))
        except RceError:
            self._pop_call(message.msgID)
            raise

    def receive(self, message: Message, link: Link) -> None:
        """Send a response, or an error, to the robot."""
        if self._pop_call(message.msg_id) is None:
            return  # the call has timed out, and the robot got an error
        try:
            if message.error:
                raise error_of(message)
            self.check_room()
        except RceError as error:
            self._fail(message, error)
            return
        self.to_robot(self._response, message.msg_id, message, None)

    def timed_out(self, call: Message) -> None:
        """Send an error to the robot."""
        self._fail(call, TimedOut(f"the service did not answer within {self._timeout:g} s"))

    def peer_lost(self, call: Message) -> None:
        """Send an error to the robot."""
        self._fail(call, NotConnected(f"interface {self.spec.tag} lost its connection before the answer came"))

    def _fail(self, call: Message, error: RceError) -> None:
        self.session.call_failed(self.spec.tag, call.msg_id, error)


def make_interface(
    spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, types: TypeRegistry, timeout: float
) -> RobotInterface:
    """Create an interface of the kind that `spec` names.

    Args:
        spec: The interface.
        hops: Recorder of the endpoint's hops.
        session: Session of the robot.
        types: Types that the robot's user has.
        timeout: Seconds until a service call fails.

    Raises:
        UnknownType: The type of a Converter is not known.
    """
    prefix = spec.kind.removesuffix("Converter").removesuffix("Forwarder")
    forward = spec.kind.endswith("Forwarder")
    name = parse_type(spec.type)
    if prefix in ("Publisher", "Subscriber"):
        image = cast(Literal["png", "jpeg", "json"], spec.format)
        codec: Codec = PassThroughCodec() if forward else types.message(name, image)
        return (Publisher if prefix == "Publisher" else Subscriber)(spec, hops, session, codec)
    request, response = itertools.repeat(PassThroughCodec(), 2) if forward else types.service(name)
    kind = ServiceClient if prefix == "ServiceClient" else ServiceProvider
    return kind(spec, hops, session, request, response, timeout)
