"""A robot's session: it outlives its socket by the grace time, and keeps the order of the robot's commands."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Iterator, Sequence
from itertools import islice
from typing import Protocol

import msgspec
from msgspec import UNSET, Raw, UnsetType
from twisted.logger import Logger

from rce import logs
from rce import messages as m
from rce.blobs import BinaryFrame, Buffer
from rce.calls.call import Nothing
from rce.calls.endpoints import InterfaceSpec
from rce.calls.robots import Execute
from rce.control import MasterLink
from rce.errors import InvalidRequest, LimitExceeded, Lost, RceError
from rce.metrics import errors
from rce.outbox import Outbox

Piece = Sequence[bytes | BinaryFrame]
"""WebSocket messages that go out together, each with whether it is binary."""

CONTROL = b""  # the outbox's source for statuses and errors
MAX_COMMANDS = 1000  # of one robot, under way
MAX_COMMAND_SIZE = 4 * 1024 * 1024  # of all of them
TURN = 20  # commands after which others on the loop have theirs
MAX_TRIES = 3

log = Logger()


class Socket(Protocol):
    """The robot's socket as the session sees it."""

    def write(self, piece: Piece) -> bool:
        """Send; returns whether there is room for more."""

    def hold(self, until: asyncio.Future[None]) -> None:
        """Take nothing from the robot until then."""

    def end(self, reason: str) -> None:
        """Close with this reason."""


class Sink(Protocol):
    """An interface of the robot, as far as its session is concerned."""

    spec: InterfaceSpec

    @property
    def connected(self) -> bool:
        """Whether it has a peer."""

    def from_robot(self, message: m.DataMessage, blobs: dict[str, Buffer]) -> None:
        """Take a data message that the robot sent. Raises what the robot shall hear."""


class Session:
    """`name` is `userID/robotID`; `features` are those that robot and server both know."""

    def __init__(self, name: str, master: MasterLink) -> None:
        self.name = name
        self.features: frozenset[str] = frozenset()
        self.interfaces: dict[str, Sink] = {}  # by tag
        self.socket: Socket | None = None
        self.token = ""
        self.connection = ""  # id of the socket, for the log
        self.outbox: Outbox[Piece] = Outbox(self._write)
        self.outbox.pause()
        self._master = master
        self._order = asyncio.Lock()
        self._count = itertools.count(1)
        self._commands: dict[asyncio.Task[None], tuple[int, int]] = {}  # how many items, how many bytes
        self._drops: dict[tuple[str, str], int] = {}
        self._drop_timer: asyncio.TimerHandle | None = None

    # --- socket -------------------------------------------------------------------------------------------------------

    @property
    def parts(self) -> bool:
        return "parts" in self.features

    def attach(self, socket: Socket, token: str, resumed: bool, grace: float) -> None:
        """The robot is here; what waited for it leaves now."""
        self.socket, self.token = socket, token
        self.outbox.abandon()  # an earlier socket may still have it
        if self.features:
            resumable = "resume" in self.features
            statuses = {tag: interface.connected for tag, interface in self.interfaces.items()} if resumed else {}
            session = m.Session(sorted(self.features), resumed=resumed, interfaces=statuses)
            if resumable:
                session = msgspec.structs.replace(session, token=token, grace=grace)
            socket.write(_piece(m.Status(session)))
        self.outbox.resume()

    def detach(self, socket: Socket) -> bool:
        """The socket is closed; False if the session has another one already."""
        if self.socket is not socket:
            return False
        self.socket = None
        self.outbox.pause()
        return True

    def hold(self, until: asyncio.Future[None]) -> None:
        if self.socket is not None:
            self.socket.hold(until)

    def end(self, reason: str) -> None:
        """The session is over."""
        for task in self._commands:
            task.cancel()
        if self._drop_timer is not None:
            self._drop_timer.cancel()
        self.outbox.clear()
        if self.socket is not None:
            self.socket.end(reason)

    def _write(self, piece: Piece) -> bool:
        return self.socket is not None and self.socket.write(piece)

    # --- to the robot -------------------------------------------------------------------------------------------------

    def interface_status(self, tag: str, status: bool) -> None:
        self.status(m.InterfaceStatus(tag, status))

    def status(self, data: m.StatusData, id: m.FrameId | UnsetType = UNSET) -> None:
        """Send an ST; topics beyond `iu` and acknowledgements go to robots with the feature `events` only."""
        if isinstance(data, m.InterfaceStatus | m.Ack) or "events" in self.features:
            self._tell(_piece(m.Status(data, id)))

    def error(self, error: RceError, id: m.FrameId | UnsetType = UNSET) -> None:
        """Send an ER about what is wrong with the robot's frame itself."""
        self._tell(self.error_piece(error, id))

    def _tell(self, piece: Piece) -> None:
        """Statuses and errors are not dropped: a robot that does not take them is not listened to."""
        self.outbox.put(CONTROL, iter([piece]), None)
        if (room := self.outbox.room(CONTROL)) is not None:
            self.hold(room)

    def error_piece(self, error: RceError, id: m.FrameId | UnsetType = UNSET) -> Piece:
        """As in the original, only what the Robot process itself finds invalid begins with these words."""
        text = f"Invalid Request: {error}" if isinstance(error, InvalidRequest) else str(error)
        return self._failure(text, error, id)

    def _failure(self, text: str, error: RceError, id: m.FrameId | UnsetType) -> Piece:
        errors.add("robot", error.info.code)
        if not self.features:
            return _piece(m.Failure(text))
        return _piece(m.Failure(text, id, error.info))

    def call_failed(self, tag: str, msg_id: str, error: RceError) -> None:
        """A service call of the robot failed."""
        self.error(error.about(iTag=tag, msgID=msg_id))

    def dropped(self, tag: str, count: int, where: str) -> None:
        """Messages were dropped, `count` in all; told once a second at most."""
        self._drops[tag, where] = count
        if self._drop_timer is None:
            self._drop_timer = asyncio.get_running_loop().call_later(1.0, self._tell_drops)

    def _tell_drops(self) -> None:
        self._drop_timer = None
        for (tag, where), count in self._drops.items():
            self.status(m.DropEvent(tag, count, where))
        self._drops.clear()

    # --- commands -----------------------------------------------------------------------------------------------------

    def command(self, frame: m.Frame) -> None:
        """Carry out a CC, DC, CN or CX: its items go to the Master in order, errors and the ack follow.

        Raises InvalidRequest where an item is malformed; those before it are carried out. LimitExceeded: none is.
        """
        size = len(memoryview(frame.data))
        room = MAX_COMMANDS - sum(count for count, _ in self._commands.values())
        if size + sum(size for _, size in self._commands.values()) > MAX_COMMAND_SIZE or room <= 0:
            raise LimitExceeded(
                f"more than {MAX_COMMANDS} commands, or of more than {MAX_COMMAND_SIZE} bytes, would be under way: "
                "wait for some to complete"
            )
        items: list[tuple[str, m.Command]] = []
        complete = False
        try:
            items.extend(islice(_items(frame), room + 1))  # keeps what came before the error
            if len(items) > room:
                items.clear()
                raise LimitExceeded(f"more than {MAX_COMMANDS} commands would be under way: wait for some to complete")
            complete = True
        finally:
            task = asyncio.create_task(self._run(frame, items, complete))
            self._commands[task] = max(1, len(items)), size
            task.add_done_callback(self._commands.pop)

    async def _run(self, frame: m.Frame, items: list[tuple[str, m.Command]], good: bool) -> None:
        answers: list[asyncio.Task[None]] = []
        logs.enter(f"{self.connection}.{next(self._count)}")
        async with self._order:
            try:
                for item, command in items:
                    answers.append(await self._issue(item, command))
                    if len(answers) % TURN == 0:
                        await asyncio.sleep(0)
            except RceError as error:  # the Master is away
                good = False
                self._failed(error, frame)
        for answer in answers:
            try:
                await answer
            except RceError as error:
                good = False
                self._failed(error, frame)
        if good and frame.id is not UNSET and "ack" in self.features:
            self.status(m.Ack(), frame.id)

    def _failed(self, error: RceError, frame: m.Frame) -> None:
        """Send an ER about a command that the Master could not carry out."""
        piece = self._failure(str(error), error, frame.id if "ack" in self.features else UNSET)
        self._tell(piece)

    async def _issue(self, item: str, command: m.Command) -> asyncio.Task[None]:
        log.info("robot {robot}: {command}", robot=self.name, command=type(command).__name__)
        answer = await self._master.issue(Execute.of(self.name, command))
        return asyncio.create_task(self._finish(item, command, answer))

    async def _finish(self, item: str, command: m.Command, answer: asyncio.Task[Nothing]) -> None:
        """Await the answer to a command; if the Master was lost meanwhile, ask the next one what became of it."""
        for tries_left in reversed(range(MAX_TRIES)):
            try:
                await answer
                return
            except Lost:
                if not tries_left:
                    raise
                answer = await self._master.issue(Execute.of(self.name, command, again=True))
            except RceError as error:
                raise error.at(item) from None


def _piece(message: m.Status | m.Failure) -> Piece:
    return [msgspec.json.encode(message)]


def _items(frame: m.Frame) -> Iterator[tuple[str, m.Command]]:
    """The commands of a frame in their order, each with its place in it; raises InvalidRequest at the first bad one."""
    if frame.type == "CC":
        yield "", m.decode_as(m.CreateContainer, frame.data, "data")
    elif frame.type == "DC":
        yield "", m.decode_as(m.DestroyContainer, frame.data, "data")
    elif frame.type == "CN":
        lists = m.decode_as(m.ConfigureComponents, frame.data, "data")
        yield from _listed(m.CN_ITEMS, {name: getattr(lists, name) for name in m.CN_ITEMS})
    elif frame.type == "CX":
        pairs = m.decode_as(m.ConfigureConnections, frame.data, "data")
        yield from _listed(m.CX_ITEMS, {name: getattr(pairs, name) for name in m.CX_ITEMS})
    else:
        raise InvalidRequest(f"message type {frame.type[:40]!r} is not supported: it is CC, DC, CN, CX or DM")


def _listed(kinds: dict[str, type[m.Command]], lists: dict[str, list[Raw]]) -> Iterator[tuple[str, m.Command]]:
    for name, kind in kinds.items():
        for index, raw in enumerate(lists[name]):
            item = f"{name}[{index}]"
            try:
                yield item, m.decode_as(kind, raw, item)
            except InvalidRequest as error:
                raise error.at(item) from None
