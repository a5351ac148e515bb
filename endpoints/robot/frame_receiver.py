"""Receiver of a robot's WebSocket messages: joins frames with their blobs and dispatches or rejects them."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from msgspec import UNSET

from endpoints.robot.session import RobotSession
from endpoints.robot.session_manager import SessionManager
from rce.errors import InvalidRequest, NotConnected, RceError
from rce.protocol import messages as m
from rce.protocol.assembler import Assembler, AssemblyLimits, AssemblyResult
from rce.protocol.blobs import Buffer

BAD_WINDOW = 60.0  # seconds


class FrameReceiver:
    """Receiver of one socket's messages. `end` is called with a reason to close the socket."""

    def __init__(self, manager: SessionManager, session: RobotSession, end: Callable[[str], None]) -> None:
        limits = manager.limits
        self._manager = manager
        self._session = session
        self._end = end
        self._assembler = Assembler(
            asyncio.get_running_loop().time,
            parts=session.parts,
            limits=AssemblyLimits(limits.blobs, limits.blob_memory, limits.message, limits.blob_age),
        )
        self._bad: deque[float] = deque()  # times of the bad messages within BAD_WINDOW

    def text(self, payload: bytes) -> None:
        """Handle a text message, which is a frame."""
        frame: m.Frame | None = None
        try:
            frame = m.decode_frame(payload)
            if frame.type != "DM":
                self._session.command(frame)
            elif b"*" in payload:  # a search for one byte is ten times as fast as for two
                self._dispatch(self._assembler.add_frame(frame))
            else:
                self._data(frame, {})
        except RceError as error:
            self._reject(error, frame)
        except RecursionError:
            self._reject(InvalidRequest("the message is nested too deeply"), frame)

    def binary(self, payload: bytes) -> None:
        """Handle a binary message, which is a blob or a part of one."""
        try:
            self._dispatch(self._assembler.add_blob(payload))
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
        message = m.decode_as(m.DataMessage, frame.data, "data")
        try:
            self._manager.data(self._session, message, blobs)
        except RceError as error:
            raise error.with_fields(iTag=message.iTag[:255], msgID=message.msgID[:255]) from None
        if frame.id is not UNSET and "ack" in self._session.features:
            self._session.status(m.Ack(), frame.id)

    def _reject(self, error: RceError, frame: m.Frame | None) -> None:
        """Send an error to the robot; close the socket after too many of them within a minute."""
        self._session.error(error, frame.id if frame is not None and "ack" in self._session.features else UNSET)
        limit = self._manager.limits.bad_messages
        if not limit or isinstance(error, NotConnected):  # the robot cannot know that its peer has just gone
            return
        now = asyncio.get_running_loop().time()
        self._bad.append(now)
        while self._bad[0] < now - BAD_WINDOW:
            self._bad.popleft()
        if len(self._bad) > limit:
            self._end(f"more than {limit} bad messages within a minute; the last: {error}")
