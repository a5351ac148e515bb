"""Receiver of a robot's WebSocket messages: joins frames with their blobs and dispatches or rejects them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated

from msgspec import UNSET, Meta, Struct

from endpoints.robot.intake import BadMessages, Conversions
from endpoints.robot.session import RobotSession
from rce.errors import InvalidRequest, LimitExceeded, RceError
from rce.protocol import messages as m
from rce.protocol.assembler import Assembler, AssemblyLimits, AssemblyResult
from rce.protocol.blobs import STAR, Buffer

LARGE = 256 * 1024  # bytes of a text frame whose content is left to its converter where possible
MAX_OTHER = 4 * LARGE  # bytes of a text frame that must be decoded as a whole: a few milliseconds of the event loop

AnyFrame = m.Frame | m.DataFrame
Handle = Callable[[RobotSession, m.DataMessage, dict[str, Buffer]], asyncio.Task[None] | None]


class ServerLimits(Struct, frozen=True):
    """Limits of what one robot may send; sizes in bytes, times in seconds."""

    message: Annotated[int, Meta(ge=1024)] = 64 * 1024 * 1024
    bad_messages: Annotated[int, Meta(ge=0)] = 100  # a minute; 0: no limit
    blobs: Annotated[int, Meta(ge=1)] = 64
    blob_memory: Annotated[int, Meta(ge=1024)] = 256 * 1024 * 1024
    blob_age: Annotated[float, Meta(gt=0)] = 60.0


class FrameReceiver:
    """Receiver of one socket's messages."""

    def __init__(self, session: RobotSession, limits: ServerLimits, handle: Handle, end: Callable[[str], None]) -> None:
        """Create the receiver of a socket.

        Args:
            session: The robot's session, which executes its commands.
            limits: Limits of what the robot may send.
            handle: Handles a data message of the robot, or returns a task that does; errors are sent to the robot.
            end: Called with a reason to close the socket.
        """
        self._session = session
        self._bad = BadMessages(limits.bad_messages, end)
        self._conversions = Conversions(session.pause_reading)
        self._handle = handle
        self._assembler = Assembler(
            asyncio.get_running_loop().time,
            parts=session.parts,
            limits=AssemblyLimits(limits.blobs, limits.blob_memory, limits.message, limits.blob_age),
        )

    def text(self, payload: bytes) -> None:
        """Handle a text message, which is a frame."""
        small = len(payload) <= LARGE and STAR not in payload
        frame = m.decode_data_frame(payload) if small else None
        if frame is None:
            self._other(payload)
            return
        try:
            self._message(frame, frame.data, {}, len(payload))
        except RceError as error:
            self._reject(error, frame)

    def _other(self, payload: bytes) -> None:
        """Handle a frame that is large, has blobs, is no data message, or is malformed."""
        frame: m.Frame | None = None
        try:
            large = m.split_large(payload) if len(payload) > LARGE else None
            if large is None and len(payload) > MAX_OTHER:
                frame = m.envelope_of(payload)
                raise _too_large(len(payload))
            frame = m.decode_frame(payload) if large is None else large.frame
            if large is not None:
                self._message(frame, large.message, {}, len(payload))
            elif frame.type != "DM":
                self._session.command(frame)
            elif STAR in payload:
                self._dispatch(self._assembler.add_frame(frame))
            else:
                self._data(frame, {})
        except RceError as error:
            self._reject(error, frame)
        except RecursionError:
            self._reject(InvalidRequest("the message is nested too deeply"), frame)

    def binary(self, *fragments: bytes) -> None:
        """Handle a binary message, which is a blob or a part of one."""
        try:
            self._dispatch(self._assembler.add_blob(*fragments))
        except RceError as error:
            self._reject(error, None)

    def sweep(self) -> None:
        """Reject frames whose blobs did not come in time, and blobs whose frames did not."""
        for dropped in self._assembler.sweep():
            self._reject(dropped.error, dropped.frame)

    def _dispatch(self, outcome: AssemblyResult) -> None:
        for dropped in outcome.dropped:
            self._reject(dropped.error, dropped.frame)
        if outcome.complete is not None:
            try:
                self._data(outcome.complete.frame, dict(outcome.complete.blobs))
            except RceError as error:
                self._reject(error, outcome.complete.frame)

    def _data(self, frame: m.Frame, blobs: dict[str, Buffer]) -> None:
        size = len(memoryview(frame.data)) + sum(map(len, blobs.values()))
        self._message(frame, m.decode_as(m.DataMessage, frame.data, "data"), blobs, size)

    def _message(self, frame: AnyFrame, message: m.DataMessage, blobs: dict[str, Buffer], size: int) -> None:
        if message.stream and not self._begin(frame, message):
            return
        try:
            conversion = self._handle(self._session, message, blobs)
        except RceError as error:
            self._end(message, error)
            raise _of_message(error, message) from None
        if conversion is not None:
            self._conversions.add(conversion, size, lambda error: self._converted(error, frame, message))
        elif message.stream or frame.id is not UNSET:
            self._converted(None, frame, message)

    def _begin(self, frame: AnyFrame, message: m.DataMessage) -> bool:
        """Begin to take a message of a stream; return False if it came before."""
        if self._session.streams.taken(message):
            self._acknowledge(frame)
            return False
        return self._session.streams.begin(message)

    def _end(self, message: m.DataMessage, error: RceError | None) -> None:
        if message.stream:
            self._session.streams.end(message, error)

    def _converted(self, error: RceError | None, frame: AnyFrame, message: m.DataMessage) -> None:
        self._end(message, error)
        if error is None:
            self._acknowledge(frame)
        else:
            self._reject(_of_message(error, message), frame)

    def _acknowledge(self, frame: AnyFrame) -> None:
        if frame.id is not UNSET and "ack" in self._session.features:
            self._session.status(m.Ack(), frame.id)

    def _reject(self, error: RceError, frame: AnyFrame | None) -> None:
        """Send an error to the robot; close the socket after too many of them within a minute."""
        self._session.error(error, frame.id if frame is not None and "ack" in self._session.features else UNSET)
        self._bad.count(error)


def _too_large(size: int) -> LimitExceeded:
    return LimitExceeded(
        f"the text frame has {size} bytes: only a data message without blobs may have more than {MAX_OTHER}; "
        "send the large part as a blob, or divide the frame",
        bytes=MAX_OTHER,
    )


def _of_message(error: RceError, message: m.DataMessage) -> RceError:
    return error.with_fields(iTag=message.iTag[:255], msgID=message.msgID[:255])
