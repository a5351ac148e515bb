"""What a robot sends over its open socket: frames and blobs are joined, taken or refused."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from msgspec import UNSET

from endpoints.robot.door import Door
from endpoints.robot.session import Session
from rce import messages as m
from rce.assembler import Assembler, Limits, Outcome
from rce.blobs import Buffer
from rce.errors import InvalidRequest, NotConnected, RceError

BAD_WINDOW = 60.0  # seconds


class Intake:
    """Of one socket; `end` closes it with a reason."""

    def __init__(self, door: Door, session: Session, end: Callable[[str], None]) -> None:
        limits = door.limits
        self._door = door
        self._session = session
        self._end = end
        self._assembler = Assembler(
            asyncio.get_running_loop().time,
            parts=session.parts,
            limits=Limits(limits.blobs, limits.blob_memory, limits.message, limits.blob_age),
        )
        self._bad: deque[float] = deque()

    def text(self, payload: bytes) -> None:
        """A text message: a frame."""
        frame: m.Frame | None = None
        try:
            frame = m.decode_frame(payload)
            if frame.type != "DM":
                self._session.command(frame)
            elif b"*" in payload:  # one byte is looked for ten times as fast as two
                self._take(self._assembler.frame(frame))
            else:
                self._data(frame, {})
        except RceError as error:
            self._refuse(error, frame)
        except RecursionError:
            self._refuse(InvalidRequest("the message is nested too deeply"), frame)

    def binary(self, payload: bytes) -> None:
        """A binary message: a blob or a part of one."""
        try:
            self._take(self._assembler.blob(payload))
        except RceError as error:
            self._refuse(error, None)

    def sweep(self) -> None:
        """Refuse what has waited for its blobs for too long."""
        for dropped in self._assembler.sweep():
            self._refuse(dropped.error, dropped.frame)

    def _take(self, outcome: Outcome) -> None:
        for dropped in outcome.dropped:
            self._refuse(dropped.error, dropped.frame)
        if outcome.complete is not None:
            try:
                self._data(outcome.complete.frame, dict(outcome.complete.blobs))
            except RceError as error:
                self._refuse(error, outcome.complete.frame)

    def _data(self, frame: m.Frame, blobs: dict[str, Buffer]) -> None:
        message = m.decode_as(m.DataMessage, frame.data, "data")
        try:
            self._door.data(self._session, message, blobs)
        except RceError as error:
            raise error.about(iTag=message.iTag[:255], msgID=message.msgID[:255]) from None
        if frame.id is not UNSET and "ack" in self._session.features:
            self._session.status(m.Ack(), frame.id)

    def _refuse(self, error: RceError, frame: m.Frame | None) -> None:
        """Tell the robot what was wrong; too many of these within a minute close the socket."""
        self._session.error(error, frame.id if frame is not None and "ack" in self._session.features else UNSET)
        most = self._door.limits.bad_messages
        if not most or isinstance(error, NotConnected):  # the robot cannot know that its peer has just gone
            return
        now = asyncio.get_running_loop().time()
        self._bad.append(now)
        while self._bad[0] < now - BAD_WINDOW:
            self._bad.popleft()
        if len(self._bad) > most:
            self._end(f"more than {most} bad messages within a minute; the last: {error}")
