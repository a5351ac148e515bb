"""Interfaces of a robot: Publisher, Subscriber, ServiceClient and ServiceProvider, each as Converter or Forwarder.

Names are from the cloud's point of view: a `Publisher` sends the cloud's messages to the robot, a `ServiceClient` calls
a service of the robot. A Converter converts between JSON and CDR, a Forwarder passes CDR through.
"""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Callable, Iterator, Mapping
from time import perf_counter
from typing import Literal, cast

import msgspec
from msgspec import UNSET

from converters import Recipe, TypeRegistry, Wire
from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import Interface, error_of
from endpoints.data.link import Link
from endpoints.robot.conversion import Codec, FromRobot, Outgoing, ToRobot
from endpoints.robot.session import Piece, RobotSession
from endpoints.robot.workers import Workers
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import ConversionError, InvalidRequest, LimitExceeded, NotConnected, RceError, TimedOut
from rce.net.budget import OVERHEAD
from rce.protocol.blobs import ID_SIZE, Buffer, binary_frames
from rce.protocol.messages import MAX_MSG_ID, DataMessage
from rce.protocol.names import parse_type

ENCAPSULATIONS = (b"\0\0", b"\0\1")  # CDR, big and little endian
MAX_PENDING = 1000  # unanswered service calls of one interface

Codecs = Callable[[], Codec]
"""Returns the codec for the present features of the robot."""


class PassThroughCodec:
    """Codec of Forwarders, for which the blob of a message is its CDR.

    Other bytes reach the Forwarders of other robots, as with the original, but nobody else; the robot is told once.
    """

    recipe = Recipe("", "json")  # for no worker

    def __init__(self, tag: str, report: Callable[[RceError], None]) -> None:
        self._tag = tag
        self._report = report
        self._reported = False

    def encodes_fast(self, wire: Wire) -> bool:
        """Return True: nothing is converted."""
        return True

    def decodes_fast(self, cdr: Buffer) -> bool:
        """Return True: nothing is converted."""
        return True

    def encode(self, wire: Wire) -> Buffer:
        """Return the blob of a message; raise InvalidRequest if it is not exactly one blob."""
        if not wire.is_blob or len(wire.blobs) != 1:
            raise InvalidRequest(
                "the message of a Forwarder must be one blob: send msg* with the blob's id", field="msg"
            )
        blob = next(iter(wire.blobs.values()))
        if not self._reported and (len(blob) < 4 or bytes(blob[:2]) not in ENCAPSULATIONS):
            self._reported = True
            self._report(
                ConversionError(
                    f"interface {self._tag}: the blob is not CDR, the serialized form of ROS 2: it begins with "
                    f"{bytes(blob[:4]).hex()!r}. Only Forwarders of other robots get it; "
                    "ROS 1 and compressed (gzip_lvl) bytes are not converted",
                    field="msg",
                )
            )
        return blob

    def decode(self, cdr: Buffer) -> Wire:
        """Return the CDR as a blob with a new id."""
        name = uuid.uuid4().hex
        return Wire(True, b'"%b"' % name.encode(), {name: cdr})


class RobotInterface(Interface):
    """Base of the four kinds: holds the robot's session and encodes data messages for it."""

    way = "from the robot"  # on which messages may be dropped

    def __init__(self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, workers: Workers) -> None:
        super().__init__(spec, hops, session.budget)
        self.session = session
        user = session.name.partition("/")[0]
        self._from_robot = FromRobot(workers, user)
        self._to_robot = ToRobot(workers, user, self._converted, self.undelivered)
        self._type = parse_type(spec.type)
        quoted = msgspec.json.encode({"iTag": spec.tag, "type": spec.type})[:-1]
        self._head = b'{"type":"DM","data":' + quoted + b',"msgID":'
        session.interfaces[spec.tag] = self

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Handle a data message of the robot; return a task if that takes longer. Errors are sent to the robot."""
        raise NotImplementedError

    def started(self) -> None:
        """Tell the robot that the interface has a peer."""
        self.session.interface_status(self.spec.tag, True)

    def stopped(self) -> None:
        """Tell the robot that the interface has no peer any more."""
        self.session.interface_status(self.spec.tag, False)

    def close(self) -> None:
        """Drop the waiting messages and remove the interface from its session."""
        self._to_robot.close()
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
        outgoing = Outgoing(codec, self._head + msgspec.json.encode(msg_id), message, keep)
        if self._to_robot.empty and codec.decodes_fast(message.payload):
            dropped = self.session.outbox.put(self.id, self._pieces(outgoing), keep, size, self)
        else:
            dropped = self._to_robot.put(outgoing, size, self)
        if dropped:
            self.dropped += dropped
            self.report_drops()

    def backlog(self) -> int:
        """Return the number of messages that wait for the robot."""
        return self._to_robot.backlog() + self.session.outbox.backlog(self.id)

    def _pieces(self, outgoing: Outgoing) -> Iterator[Piece]:
        try:
            frame, blobs = outgoing.convert()
            self._check_size(frame, blobs)
        except RceError as error:  # later: this runs within the robot's queue, which the report enters too
            asyncio.get_running_loop().call_soon(self.undelivered, outgoing, error)
            return
        yield from self._frames(outgoing.message, frame, blobs)

    def _converted(self, outgoing: Outgoing, frame: Buffer, blobs: Mapping[str, Buffer]) -> None:
        """Queue a message that a worker has converted."""
        try:
            self._check_size(frame, blobs)
        except LimitExceeded as error:
            self.undelivered(outgoing, error)
            self._to_robot.proceed()
            return
        size = len(frame) + sum(map(len, blobs.values())) + OVERHEAD
        pieces = self._begun(self._frames(outgoing.message, frame, blobs))
        dropped = self.session.outbox.put(self.id, pieces, outgoing.keep, size, self)
        if dropped:
            self.evicted(dropped)

    def _begun(self, pieces: Iterator[Piece]) -> Iterator[Piece]:
        self._to_robot.proceed()
        yield from pieces

    def _check_size(self, frame: Buffer, blobs: Mapping[str, Buffer]) -> None:
        """Raise LimitExceeded if a robot cannot receive a message; with `parts` its blobs may have any size."""
        largest = len(frame)
        if blobs and not self.session.parts:
            largest = max(largest, ID_SIZE + max(map(len, blobs.values())))
        if largest > self.session.limit:
            raise LimitExceeded(
                f"interface {self.spec.tag}: a message has {largest} bytes for robot {self.spec.owner}, which takes "
                f"{self.session.limit}: send less at a time",
                bytes=self.session.limit,
            )

    def _frames(self, message: Message, frame: Buffer, blobs: Mapping[str, Buffer]) -> Iterator[Piece]:
        parts = self.session.parts
        frames = binary_frames(blobs, parts)
        if parts:
            yield [frame]
            yield from ([each] for each in frames)
        else:  # in one piece: old clients expect the blobs right after their frame
            yield [frame, *frames]
        self.hops.delivered(self.id, message)

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """Handle a message that cannot be sent to the robot."""
        self.session.error(error.with_item(self.spec.tag))

    def evicted(self, count: int) -> None:
        """Count and report messages that were dropped from a queue because a larger budget was exceeded."""
        super().evicted(count)
        self.report_drops()
        self._to_robot.proceed()  # the message of which it waits may be among them

    def report_drops(self) -> None:
        """Report to the robot the messages that were dropped."""
        self.session.dropped(self.spec.tag, self.dropped, f"on the way {self.way}")


class Publisher(RobotInterface):
    """Sends messages of a topic to the robot."""

    way = "to the robot"

    def __init__(
        self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, workers: Workers, codec: Codecs
    ) -> None:
        super().__init__(spec, hops, session, workers)
        self._codec = codec

    def receive(self, message: Message, link: Link) -> None:
        """Queue a message for the robot; with `keep_all`, pause the link while the queue is full."""
        self.to_robot(self._codec(), message.msg_id, message, self.keep)
        if self.keep is None:
            room = self._to_robot.wait_for_room() or self.session.outbox.wait_for_room(self.id)
            if room is not None:
                link.pause(room)

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """Count a message that is too large for the robot, and tell its sender."""
        if not isinstance(error, LimitExceeded):
            super().undelivered(outgoing, error)
            return
        message = outgoing.message
        self.dropped += 1
        if message.source in self.peers:
            self.traffic.of(message.source).drops += 1
        self.report_drops()
        self.fail(message, error)

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Reject the message: this interface only sends to the robot."""
        raise InvalidRequest(
            f"interface {self.spec.tag} is a {self.spec.kind}: the robot receives from it and cannot send to it",
            field="iTag",
        )


class Subscriber(RobotInterface):
    """Receives messages of a topic from the robot."""

    def __init__(
        self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, workers: Workers, codec: Codecs
    ) -> None:
        super().__init__(spec, hops, session, workers)
        self._codec = codec

    def receive(self, message: Message, link: Link) -> None:
        """Report the error of a message that did not reach its receiver; this interface receives nothing else."""
        if message.error:
            self.session.error(error_of(message).with_fields(iTag=self.spec.tag, msgID=message.msg_id))

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Convert a message and send it to all peers; with `keep_all`, pause the robot while a link is full."""
        since = perf_counter()
        wire, codec = self.wire(message, blobs), self._codec()
        if not self.peers and not codec.encodes_fast(wire):
            self._send(message.msgID, b"", since)  # nobody gets it, so it is not converted
            return None
        return self._from_robot.convert(codec, wire, lambda cdr: self._send(message.msgID, cdr, since))

    def _send(self, msg_id: str, payload: Buffer, since: float) -> None:
        before = self.dropped
        try:
            self.send(Message(self.id, msg_id, payload, entered_at=since))
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
        workers: Workers,
        request: Codecs,
        response: Codecs,
        timeout: float,
    ) -> None:
        super().__init__(spec, hops, session, workers)
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
        if self.budget.full and self.backlog():
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
        self.to_robot(self._request(), name, message, None)

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
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
            return None

        def answer(cdr: Buffer) -> None:
            self.request(Message(self.id, request.msg_id, cdr, destination=request.source, entered_at=since))

        try:
            task = self._from_robot.convert(self._response(), self.wire(message, blobs), answer)
        except RceError as error:
            self.fail(request, error)
            raise
        if task is not None:
            task.add_done_callback(lambda done: self._fail_with(request, done))
        return task

    def _fail_with(self, request: Message, done: asyncio.Task[None]) -> None:
        """Fail a call whose answer could not be converted."""
        if not done.cancelled() and isinstance(error := done.exception(), RceError):
            self.fail(request, error)

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """Answer the call with the error."""
        for name, (request, _) in self._waiting.items():
            if request.source == outgoing.message.source and request.msg_id == outgoing.message.msg_id:
                self._pop_call(name)
                self.fail(request, error)
                break
        super().undelivered(outgoing, error)

    def timed_out(self, call: Message) -> None:
        """Answer the call with an error."""
        self.fail(call, TimedOut(f"robot {self.spec.owner} did not answer within {self._timeout:g} s"))

    def peer_lost(self, call: Message) -> None:
        """Do nothing: the interface that made the call is gone."""


class ServiceProvider(ServiceInterface):
    """Passes service calls from the robot to the cloud, which answers them."""

    def from_robot(self, message: DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Send a request of the robot to the service."""
        self._check_new(message.msgID)
        since = perf_counter()
        wire, codec = self.wire(message, blobs), self._request()
        if not self.peers and not codec.encodes_fast(wire):
            self._call(message.msgID, b"", since)  # nobody gets it, so it is not converted
            return None
        return self._from_robot.convert(codec, wire, lambda cdr: self._call(message.msgID, cdr, since))

    def _check_new(self, msg_id: str) -> None:
        if msg_id in self._waiting:
            raise InvalidRequest(
                f"interface {self.spec.tag} has an unanswered call with this msgID: use a new one", field="msgID"
            )

    def _call(self, msg_id: str, payload: Buffer, since: float) -> None:
        self._check_new(msg_id)  # again: another may have come while this one was converted
        request = Message(self.id, msg_id, payload, entered_at=since)
        # Before the request leaves: a peer in this process may answer at once.
        self._add_call(msg_id, Message(self.id, msg_id, b""))
        try:
            self.request(request)
        except RceError:
            self._pop_call(msg_id)
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
        self.to_robot(self._response(), message.msg_id, message, None)

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """Send an error to the robot."""
        self._fail(outgoing.message, error.with_item(self.spec.tag))

    def timed_out(self, call: Message) -> None:
        """Send an error to the robot."""
        self._fail(call, TimedOut(f"the service did not answer within {self._timeout:g} s"))

    def peer_lost(self, call: Message) -> None:
        """Send an error to the robot."""
        self._fail(call, NotConnected(f"interface {self.spec.tag} lost its connection before the answer came"))

    def _fail(self, call: Message, error: RceError) -> None:
        self.session.call_failed(self.spec.tag, call.msg_id, error)


def make_interface(
    spec: InterfaceSpec,
    hops: HopRecorder,
    session: RobotSession,
    workers: Workers,
    types: TypeRegistry,
    timeout: float,
) -> RobotInterface:
    """Create an interface of the kind that `spec` names.

    Args:
        spec: The interface.
        hops: Recorder of the endpoint's hops.
        session: Session of the robot.
        workers: Workers for messages whose conversion takes long.
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
        codec = _codecs(session, spec.tag, forward, lambda original: types.message(name, image, original=original))
        return (Publisher if prefix == "Publisher" else Subscriber)(spec, hops, session, workers, codec)
    request = _codecs(session, spec.tag, forward, lambda original: types.service(name, original=original).request)
    response = _codecs(session, spec.tag, forward, lambda original: types.service(name, original=original).response)
    kind = ServiceClient if prefix == "ServiceClient" else ServiceProvider
    return kind(spec, hops, session, workers, request, response, timeout)


def _codecs(session: RobotSession, tag: str, forward: bool, choose: Callable[[bool], Codec]) -> Codecs:
    """Return the codec of an interface as a function, because the features of a session may change when it resumes.

    A robot without features is a client of the original and gets its JSON.
    """
    if forward:
        codec = PassThroughCodec(tag, session.error)
        return lambda: codec
    choose(not session.features)  # raises UnknownType
    return lambda: choose(not session.features)
