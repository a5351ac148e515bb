"""Interfaces of a robot for topics, and the base of all kinds (see `services` and `actions` for the others).

Names are from the cloud's point of view: a `Publisher` sends the cloud's messages to the robot. As a Converter it
converts between JSON and CDR, as a Forwarder it passes CDR through.
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from time import monotonic, perf_counter

import msgspec
from msgspec import UNSET

from converters import Wire
from converters.reduction import AnyCodec as Codec
from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import Interface, error_of
from endpoints.data.link import Link
from endpoints.robot.conversion import FromRobot, Outgoing, ToRobot
from endpoints.robot.formats import Codecs
from endpoints.robot.pace import SHORTEST, Pace
from endpoints.robot.session import Piece, RobotSession
from endpoints.robot.workers import Workers
from rce.control.calls.endpoints import InterfaceSpec
from rce.errors import InvalidRequest, LimitExceeded, NotConnected, RceError
from rce.net.budget import OVERHEAD
from rce.net.outbox import Priority
from rce.protocol.blobs import ID_SIZE, Buffer, binary_frames
from rce.protocol.messages import MAX_MSG_ID, DataMessage
from rce.protocol.names import parse_type

NO_ID = "nil"  # msgID that robots give to all messages of a topic, by convention


def _wire_id(message: Message) -> str:
    return NO_ID if message.numbered else message.msg_id


class RobotInterface(Interface):
    """Base of all kinds: holds the robot's session and encodes data messages for it."""

    way = "from the robot"  # on which messages may be dropped

    def __init__(self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, workers: Workers) -> None:
        super().__init__(spec, hops, session.budget)
        self.session = session
        user = session.name.partition("/")[0]
        self._from_robot = FromRobot(workers, user)
        self._to_robot = ToRobot(workers, user, self._converted, self.undelivered)
        self._priority = Priority[spec.delivery.priority.upper()]
        self._max_age = spec.delivery.maxAge
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

    def to_robot(self, codec: Codec, msg_id: str, message: Message, keep: int | None, more: bytes = b"") -> None:
        """Queue a data message for the robot, with `more` fields as JSON.

        The message is converted when it leaves the queue, so a dropped message costs no conversion.
        """
        size = len(message.payload) + OVERHEAD
        until = monotonic() + self._max_age if self._max_age else math.inf
        outgoing = Outgoing(codec, self._head + msgspec.json.encode(msg_id) + more, message, keep, until)
        if self._to_robot.empty and codec.decodes_fast(message.payload):
            dropped = self._put_in_outbox(outgoing, self._pieces(outgoing), size)
        else:
            dropped = self._to_robot.put(outgoing, size, self)
        if dropped:
            self.dropped += dropped
            self.report_drops()

    def _put_in_outbox(self, outgoing: Outgoing, pieces: Iterator[Piece], size: int) -> int:
        """Queue the pieces of a message; return the number of dropped messages."""
        outbox = self.session.outbox
        return outbox.put(self.id, pieces, outgoing.keep, size, self, self._priority)

    def backlog(self) -> int:
        """Return the number of messages that wait for the robot."""
        return self._to_robot.backlog() + self.session.outbox.backlog(self.id)

    def _too_old(self, outgoing: Outgoing) -> bool:
        """Return whether the turn of a message comes too late; count and report it if so."""
        if not self._max_age or monotonic() <= outgoing.until:
            return False
        asyncio.get_running_loop().call_soon(self.evicted, 1)  # later: this runs within the robot's queue
        return True

    def _pieces(self, outgoing: Outgoing) -> Iterator[Piece]:
        if self._too_old(outgoing):
            return
        try:
            frame, blobs = outgoing.convert()
            self._check_size(frame, blobs)
        except RceError as error:  # later: this runs within the robot's queue, which the report enters too
            asyncio.get_running_loop().call_soon(self.undelivered, outgoing, error)
            return
        yield from self._divided(frame, blobs)
        self.hops.delivered(self.id, outgoing.message)

    def _converted(self, outgoing: Outgoing, frame: Buffer, blobs: Mapping[str, Buffer]) -> None:
        """Queue a message that a worker has converted."""
        try:
            self._check_size(frame, blobs)
        except LimitExceeded as error:
            self.undelivered(outgoing, error)
            self._to_robot.proceed()
            return
        size = len(frame) + sum(map(len, blobs.values())) + OVERHEAD
        pieces = self._begun(outgoing, self._frames(outgoing.message, frame, blobs))
        dropped = self._put_in_outbox(outgoing, pieces, size)
        if dropped:
            self.evicted(dropped)

    def _begun(self, outgoing: Outgoing, pieces: Iterator[Piece]) -> Iterator[Piece]:
        self._to_robot.proceed()
        if not self._too_old(outgoing):
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
        yield from self._divided(frame, blobs)
        self.hops.delivered(self.id, message)

    def _divided(self, frame: Buffer, blobs: Mapping[str, Buffer]) -> Iterable[Piece]:
        return self._with_blobs(frame, blobs) if blobs else [[frame]]

    def _with_blobs(self, frame: Buffer, blobs: Mapping[str, Buffer]) -> Iterator[Piece]:
        parts = self.session.parts
        frames = binary_frames(blobs, parts, self.session.part)
        if not parts or sum(map(len, blobs.values())) <= self.session.part():
            yield [frame, *frames]  # in one piece; old clients expect the blobs right after their frame
        else:
            yield [frame]
            yield from ([each] for each in frames)

    def undelivered(self, outgoing: Outgoing, error: RceError) -> None:
        """Handle a message that cannot be sent to the robot."""
        self.session.error(error.with_item(self.spec.tag))

    def evicted(self, count: int) -> None:
        """Count and report messages that were dropped from a queue: a budget was exceeded, or they were too old."""
        super().evicted(count)
        self.report_drops()
        self._to_robot.proceed()  # the message of which it waits may be among them

    def report_drops(self) -> None:
        """Report to the robot the messages that were dropped."""
        self.session.dropped(self.spec.tag, self.dropped, f"on the way {self.way}")


class Publisher(RobotInterface):
    """Sends messages of a topic to the robot, all of them or at a pace."""

    way = "to the robot"
    _pace: Pace | None = None

    def __init__(
        self, spec: InterfaceSpec, hops: HopRecorder, session: RobotSession, workers: Workers, codec: Codecs
    ) -> None:
        super().__init__(spec, hops, session, workers)
        self._codec = codec
        if spec.delivery.rate:
            self.set_pace(1 / spec.delivery.rate, length=1)

    def receive(self, message: Message, link: Link) -> None:
        """Queue a message for the robot; with `keep_all`, pause the link while the queue is full."""
        if self._pace is not None and not self._pace.admits(message, self._queue):
            return
        self._queue(message)
        if self.keep is None:
            room = self._to_robot.wait_for_room() or self.session.outbox.wait_for_room(self.id)
            if room is not None:
                link.pause(room)

    def close(self) -> None:
        """Drop the waiting messages and remove the interface from its session."""
        if self._pace is not None:
            self._pace.close()
        super().close()

    def set_pace(self, interval: float, length: int) -> None:
        """Send one message in an interval at most.

        Args:
            interval: Seconds; less than a millisecond to send every message.
            length: Number of messages that may wait, the newest; 0 to leave it as it is.
        """
        old, self._pace = self._pace, Pace(interval, length, self.budget) if interval >= SHORTEST else None
        if old is not None:
            old.close()
            if self._pace is not None:
                self._pace.follow(old)
        if length:
            self.keep = length

    def _queue(self, message: Message) -> None:
        self.to_robot(self._codec(), _wire_id(message), message, self.keep)

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
        self._numbers = itertools.count(1)

    def receive(self, message: Message, link: Link) -> None:
        """Report the error of a message that did not reach its receiver; this interface receives nothing else."""
        if message.error:
            self.session.error(error_of(message).with_fields(iTag=self.spec.tag, msgID=_wire_id(message)))

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
        numbered = msg_id == NO_ID
        if numbered:  # so that a trace tells the messages apart
            msg_id = f"{NO_ID}-{next(self._numbers):x}"
        try:
            self.send(Message(self.id, msg_id, payload, numbered=numbered, entered_at=since))
        except NotConnected:
            if self.session.features:
                raise
            return  # clients of the original protocol go on publishing when a peer is gone
        if self.dropped != before:
            self.report_drops()
        if (room := self.wait_for_room()) is not None:
            self.session.pause_reading(room)
