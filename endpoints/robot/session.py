"""A robot's session at the Robot endpoint.

A session outlives its socket by the grace time, queues messages to the robot, and keeps the order of its commands.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Protocol

import msgspec
from msgspec import UNSET, Raw, UnsetType
from twisted.logger import Logger

from endpoints.robot.streams import Streams
from rce.control.calls.endpoints import InterfaceSpec
from rce.control.calls.robots import Execute, Executed
from rce.control.client import ControlClient
from rce.errors import InvalidRequest, LimitExceeded, Lost, RceError
from rce.net.budget import Budget
from rce.net.outbox import Outbox
from rce.process import logs
from rce.process.metrics import errors
from rce.protocol import messages as m
from rce.protocol.blobs import PART, BinaryFrame, Buffer, TextFrame
from rce.value_count import check_value_count

Piece = Sequence[Buffer | BinaryFrame | TextFrame]
"""WebSocket messages that are written together: text as a buffer or TextFrame, binary messages as BinaryFrame."""

CONTROL = b""  # source of statuses and errors in the outbox
MAX_COMMANDS = 1000  # of one robot that are in progress
MAX_COMMAND_SIZE = 1024 * 1024  # bytes of all these commands
MAX_TRIES = 3
MAX_MESSAGE = 64 * 1024 * 1024  # bytes
MAX_SHOWN = 20  # interfaces in a summary of dropped messages
MAX_STATUSES = 10_000  # statuses and errors that may wait for a robot before its socket is closed

log = Logger()


class Socket(Protocol):
    """The robot's socket as the session sees it."""

    @property
    def part(self) -> int:
        """Bytes of the next part of a large message."""

    def write(self, piece: Piece) -> bool:
        """Send a piece; return True if there is room for more."""

    def pause_reading(self, until: asyncio.Future[None]) -> None:
        """Stop receiving from the robot until the future is done."""

    def end(self, reason: str) -> None:
        """Close the socket with this reason."""


class SessionInterface(Protocol):
    """An interface of the robot as the session sees it."""

    spec: InterfaceSpec

    @property
    def connected(self) -> bool:
        """True if the interface has a peer."""

    def from_robot(self, message: m.DataMessage, blobs: dict[str, Buffer]) -> asyncio.Task[None] | None:
        """Handle a data message of the robot; return a task if that takes longer. Errors are sent to the robot."""


class RobotSession:
    """Session of one robot.

    Attributes:
        name: Name of the robot, `userID/robotID`.
        features: Protocol features that both the robot and the server support.
        interfaces: Interfaces of the robot, by tag.
        socket: The open socket; None during the grace time.
        token: Secret with which a later socket resumes the session.
        connection: Id of the connection, which marks log lines about its commands.
        outbox: Messages to the robot.
        budget: Bytes that messages from and to the robot may hold while they wait.
        limit: Bytes of the largest WebSocket message that the robot takes.
        streams: Numbered messages of the robot that were taken.
    """

    def __init__(
        self,
        name: str,
        master: ControlClient,
        streams: Streams,
        budget: Budget | None = None,
        limit: int = MAX_MESSAGE,
    ) -> None:
        """Create a session without a socket; `budget` is unlimited by default."""
        self.name = name
        self.features: frozenset[str] = frozenset()
        self.interfaces: dict[str, SessionInterface] = {}
        self.socket: Socket | None = None
        self.token = ""
        self.connection = ""
        self.budget = budget or Budget(sys.maxsize)
        self.limit = limit
        self.streams = streams
        self.outbox: Outbox[Piece] = Outbox(self._write)
        self.outbox.pause()
        self._master = master
        self._order = asyncio.Lock()
        self._count = itertools.count(1)
        self._commands: dict[asyncio.Task[None], tuple[int, int]] = {}  # number of items, number of bytes
        self._drops: dict[tuple[str, str], int] = {}  # number of all drops, by interface and direction
        self._drop_timer: asyncio.TimerHandle | None = None

    # --- socket -------------------------------------------------------------------------------------------------------

    @property
    def parts(self) -> bool:
        """True if large messages are split into parts (feature `parts`)."""
        return "parts" in self.features

    def attach(self, socket: Socket, token: str, resumed: bool, grace: float) -> None:
        """Use a new socket: send the session's status, then the messages that wait."""
        self.socket, self.token = socket, token
        self.outbox.abort_current()  # a message of which an earlier socket sent a part is not sent again
        if self.features:
            resumable = "resume" in self.features
            statuses = {tag: interface.connected for tag, interface in self.interfaces.items()} if resumed else {}
            session = m.Session(
                sorted(self.features), resumed=resumed, interfaces=statuses, incarnation=self.streams.incarnation
            )
            if resumable:
                session = msgspec.structs.replace(session, token=token, grace=grace)
            socket.write(_piece(m.Status(session)))
        self.outbox.resume()

    def detach(self, socket: Socket) -> bool:
        """Handle that a socket is closed; return False if the session has another socket already."""
        if self.socket is not socket:
            return False
        self.socket = None
        self.outbox.pause()
        return True

    def pause_reading(self, until: asyncio.Future[None]) -> None:
        """Stop receiving from the robot until the future is done."""
        if self.socket is not None:
            self.socket.pause_reading(until)

    def end(self, reason: str) -> None:
        """End the session: cancel its commands, drop its messages, and close its socket with the reason."""
        for task in self._commands:
            task.cancel()
        if self._drop_timer is not None:
            self._drop_timer.cancel()
        self.outbox.clear()
        if self.socket is not None:
            self.socket.end(reason)

    def part(self) -> int:
        """Return the bytes of the next part of a large message."""
        return self.socket.part if self.socket is not None else PART

    def _write(self, piece: Piece) -> bool:
        return self.socket is not None and self.socket.write(piece)

    # --- to the robot -------------------------------------------------------------------------------------------------

    def interface_status(self, tag: str, status: bool) -> None:
        """Send the status of an interface: True while it has a peer."""
        self.status(m.InterfaceStatus(tag, status))

    def status(self, data: m.StatusData, id: m.FrameId | UnsetType = UNSET) -> None:
        """Send an ST; topics other than `iu` and acknowledgements go only to robots with the feature `events`."""
        if isinstance(data, m.InterfaceStatus | m.Ack) or "events" in self.features:
            self.send(_piece(m.Status(data, id)))

    def error(self, error: RceError, id: m.FrameId | UnsetType = UNSET) -> None:
        """Send an ER about a malformed or rejected frame of the robot."""
        self.send(self.error_piece(error, id))

    def send(self, piece: Piece, size: int = 0) -> None:
        """Send a status, an error or the like, which is never dropped; while too many wait, the robot is not read.

        Args:
            piece: The piece.
            size: Bytes that are charged to the session's budget while the piece waits; 0 for a small one.
        """
        self.evicted(self.outbox.put(CONTROL, iter([piece]), None, size, self))
        if (room := self.outbox.wait_for_room(CONTROL)) is not None:
            self.pause_reading(room)
        if self.socket is not None and self.outbox.backlog(CONTROL) > MAX_STATUSES:
            self.socket.end(f"the robot has not read its last {MAX_STATUSES} statuses and errors")

    def evicted(self, count: int) -> None:
        """Close the socket: a budget was exceeded so far that statuses or answers were dropped."""
        if count and self.socket is not None:
            self.socket.end("the robot has not read its answers, which take too much memory")

    def error_piece(self, error: RceError, id: m.FrameId | UnsetType = UNSET) -> Piece:
        """Return the ER for an error that this endpoint found; the original protocol prefixes invalid requests."""
        text = f"Invalid Request: {error}" if isinstance(error, InvalidRequest) else str(error)
        return self._failure(text, error, id)

    def _failure(self, text: str, error: RceError, id: m.FrameId | UnsetType) -> Piece:
        errors.add("robot", error.info.code)
        if not self.features:
            return _piece(m.Failure(text))
        return _piece(m.Failure(text, id, error.info))

    def call_failed(self, tag: str, msg_id: str, error: RceError) -> None:
        """Send an ER about a service call of the robot that failed."""
        self.error(error.with_fields(iTag=tag, msgID=msg_id))

    def dropped(self, tag: str, count: int, where: str) -> None:
        """Report dropped messages, at most once a second.

        A robot without the feature `events` gets an ER with a summary of all its interfaces.

        Args:
            tag: The interface.
            count: Number of all messages dropped so far.
            where: Direction in which they were dropped, as the robot shall read it.
        """
        self._drops[tag, where] = count
        if self._drop_timer is None:
            self._drop_timer = asyncio.get_running_loop().call_later(1.0, self._report_drops)

    def _report_drops(self) -> None:
        self._drop_timer = None
        drops, self._drops = self._drops, {}
        if "events" in self.features:
            for (tag, where), count in drops.items():
                self.status(m.DropEvent(tag, count, where))
            return
        shown = [f"{tag}: {count} {where}" for (tag, where), count in islice(drops.items(), MAX_SHOWN)]
        more = f" and {len(drops) - MAX_SHOWN} more interfaces" if len(drops) > MAX_SHOWN else ""
        self.error(
            LimitExceeded(
                f"messages were dropped, counted since each interface was added: {', '.join(shown)}{more}; "
                "send fewer or smaller ones, or raise the depth in the qos of the interface"
            )
        )

    # --- commands -----------------------------------------------------------------------------------------------------

    def command(self, frame: m.Frame) -> None:
        """Execute a CC, DC, CN or CX frame.

        Its items go to the Master in order. Errors of the Master and the acknowledgement are sent when they come.

        Raises:
            InvalidRequest: An item is malformed; the items before it are executed.
            LimitExceeded: The frame has too many values, or too many commands are in progress; no item is executed.
        """
        size = len(memoryview(frame.data))
        room = MAX_COMMANDS - sum(count for count, _ in self._commands.values())
        if size + sum(size for _, size in self._commands.values()) > MAX_COMMAND_SIZE or room <= 0:
            raise LimitExceeded(
                f"more than {MAX_COMMANDS} commands or {MAX_COMMAND_SIZE} bytes of commands would be in progress: "
                "wait until some complete"
            )
        check_value_count(frame.data, "the frame")
        items: list[tuple[str, m.Command]] = []
        complete = False
        try:
            found = _items(frame, strict=bool(self.features))
            items.extend(islice(found, room + 1))  # keeps the items before a malformed one
            if len(items) > room:
                items.clear()
                raise LimitExceeded(f"more than {MAX_COMMANDS} commands would be in progress: wait until some complete")
            complete = True
        finally:
            task = asyncio.create_task(self._run(frame, items, complete))
            self._commands[task] = max(1, len(items)), size
            task.add_done_callback(self._commands.pop)

    async def _run(self, frame: m.Frame, items: list[tuple[str, m.Command]], good: bool) -> None:
        services: list[m.UsedService] | None = []
        if items:
            logs.set_request_id(f"{self.connection}.{next(self._count)}")
            services = await self._execute(frame, items)
        if good and services is not None and frame.id is not UNSET and "ack" in self.features:
            self.status(m.Ack(services), frame.id)

    async def _execute(self, frame: m.Frame, items: list[tuple[str, m.Command]]) -> list[m.UsedService] | None:
        """Execute the commands of a frame, and send their errors; return the services used, or None after errors."""
        commands = [command for _, command in items]
        kinds = Counter(type(command).__name__ for command in commands)
        listed = ", ".join(f"{kind} x {count}" if count > 1 else kind for kind, count in kinds.items())
        log.info("robot {robot}: {commands}", robot=self.name, commands=listed)
        try:
            executed = await self._call_master(commands)
        except RceError as error:  # no command has an answer
            self._failed(error, frame)
            return None
        for position, info in sorted(executed.failed.items()):
            self._failed(RceError.from_info(info).with_item(items[position][0]), frame)
        return None if executed.failed else [service for _, service in sorted(executed.services.items())]

    async def _call_master(self, commands: list[m.Command]) -> Executed:
        """Pass commands to the Master; after a lost connection, repeat them at the Master that joins next.

        Raises:
            RceError: The Master cannot be reached, or refuses the call as a whole.
        """
        async with self._order:
            answer = await self._master.issue(Execute.of(self.name, *commands))
        for _ in range(MAX_TRIES - 1):
            with contextlib.suppress(Lost):
                return await answer
            answer = await self._master.issue(Execute.of(self.name, *commands, again=True))
        return await answer

    def _failed(self, error: RceError, frame: m.Frame) -> None:
        """Send an ER about a command that the Master could not execute."""
        piece = self._failure(str(error), error, frame.id if "ack" in self.features else UNSET)
        self.send(piece)


def _piece(message: m.Status | m.Failure) -> Piece:
    return [msgspec.json.encode(message)]


def _items(frame: m.Frame, *, strict: bool) -> Iterator[tuple[str, m.Command]]:
    """Yield the commands of a frame in order, each with its position in the frame.

    Args:
        frame: The frame.
        strict: Refuse unknown keys.

    Raises:
        InvalidRequest: The next command is malformed.
    """
    if frame.type == "CC":
        yield "", m.decode_as(m.CreateContainer, frame.data, "data", strict=strict)
    elif frame.type == "DC":
        yield "", m.decode_as(m.DestroyContainer, frame.data, "data", strict=strict)
    elif frame.type == "CN":
        lists = m.decode_as(m.ConfigureComponents, frame.data, "data", strict=strict)
        yield from _listed(m.CN_ITEMS, {name: getattr(lists, name) for name in m.CN_ITEMS}, strict)
    elif frame.type == "CX":
        pairs = m.decode_as(m.ConfigureConnections, frame.data, "data", strict=strict)
        yield from _listed(m.CX_ITEMS, {name: getattr(pairs, name) for name in m.CX_ITEMS}, strict)
    else:
        raise InvalidRequest(f"message type {frame.type[:40]!r} is not supported: use CC, DC, CN, CX or DM")


def _listed(
    kinds: dict[str, type[m.Command]], lists: dict[str, list[Raw]], strict: bool
) -> Iterator[tuple[str, m.Command]]:
    for name, kind in kinds.items():
        for index, raw in enumerate(lists[name]):
            item = f"{name}[{index}]"
            try:
                yield item, m.decode_as(kind, raw, item, strict=strict)
            except InvalidRequest as error:
                raise error.with_item(item) from None
