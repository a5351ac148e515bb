"""A client of a gateway as a guest: a robot without a WebSocket of its own, whose frames are handled in this process.

Everything that the client uses in its environment (a topic, service or action, in one direction) is a `Use`: an
interface of the environment, one of the guest, and their connection, made by ordinary commands.
"""

from __future__ import annotations

import asyncio
import itertools
import re
import secrets
from collections.abc import Callable, Coroutine, Sequence
from contextlib import suppress
from typing import Any, Literal

import msgspec
from msgspec import UNSET, Raw
from twisted.logger import Logger

from endpoints.gateways.changes import Changes
from endpoints.gateways.graphs import Graphs
from endpoints.gateways.uses import ASK, CALL, Arrived, Frame, Kind, Sealed, Use
from endpoints.gateways.view import View
from endpoints.gateways.work import Work
from endpoints.robot.client import Accepted
from endpoints.robot.endpoint import RobotEndpoint
from endpoints.robot.handshake import LoginRequest, Request, parse_guest
from endpoints.robot.intake import Conversions
from endpoints.robot.interfaces import RobotInterface
from endpoints.robot.session import CONTROL, Piece, RobotSession, Socket
from rce.errors import NotFound, RceError, TimedOut, Unavailable
from rce.protocol import messages as m
from rce.protocol.blobs import PART, BinaryFrame, Buffer, TextFrame

FEATURES = frozenset({"ack", "events"})
CHECK = 3.0  # seconds; an environment that is still starting is not waited for longer
MAX_MAKING = 100  # uses that are made or removed at once: a session may have 1,000 commands in progress

_START = b'{"type":"DM","data":'
_CONTENT = re.compile(rb',"msg\*?":')
_message = msgspec.json.Decoder(m.DataMessage)
_answer: msgspec.json.Decoder[m.Status | m.Failure] = msgspec.json.Decoder(m.Status | m.Failure)

log = Logger()


class Guest:
    """Guest in one environment.

    Attributes:
        changes: What the client has begun to change in the environment.
        view: What it sees of the environment.

    Args:
        endpoint: The Robot endpoint.
        graphs: Graphs of environments.
        protocol: Name of the gateway, which is part of the guest's name.
        place: The environment as `TAG` or `OWNER/TAG`.
    """

    def __init__(self, endpoint: RobotEndpoint, graphs: Graphs, protocol: str, place: str) -> None:
        owner, _, self.environment = place.strip("/").rpartition("/")
        self.endpoint = endpoint
        self.user = ""
        self._owner = owner
        self._protocol = protocol
        self._session: RobotSession
        self._socket: Socket | None = None
        self._tags = itertools.count(1)
        self._ids = itertools.count(1)
        self._uses: dict[str, Use] = {}
        self._commands: dict[int, asyncio.Future[None]] = {}
        self._work = Work(self.pause_reading)
        self._making = asyncio.Semaphore(MAX_MAKING)
        self._removals: set[asyncio.Task[None]] = set()
        self.changes = Changes()
        self.view = View(endpoint, graphs, self.environment, self.changes)

    # --- login --------------------------------------------------------------------------------------------------------

    async def login(self, request: Request) -> Accepted:
        """Log in as a new guest.

        Raises:
            NotFound: There is no such environment, or the user may not see it.
            RceError: The login is refused.
        """
        user, secret = parse_guest(request)
        name = f"@{self._protocol}_{secrets.token_hex(4)}"
        owner = self._owner or user
        login = LoginRequest(user, name, secret, FEATURES, "", False, str(request.peer), owner)
        self._session = (await self.endpoint.login(login)).session
        self.user = owner
        self.view.name = self._session.name
        try:
            async with asyncio.timeout(CHECK):
                await self.view.check()
        except (TimeoutError, TimedOut, Unavailable):
            pass  # it is starting
        except BaseException:
            self.abandoned()
            raise
        return Accepted()

    def abandoned(self) -> None:
        """End the session, whose socket was never opened."""
        self.endpoint.finished(self._session)

    def opened(self, socket: Socket) -> None:
        """Begin to exchange messages."""
        self._socket = socket
        self._conversions = Conversions(socket.pause_reading)
        self._session.attach(self, "", False, 0.0)
        self.endpoint.connected(self._session)

    def closed(self, normal: bool, reason: str) -> None:
        """End the session: nothing of a guest outlives its socket."""
        self._socket = None
        self._work.cancel()
        for removal in self._removals:
            removal.cancel()
        for use in self._uses.values():
            use.cancel()
        for command in self._commands.values():
            command.cancel()
        if self._session.detach(self):
            self.endpoint.finished(self._session)

    # --- Socket of the session ----------------------------------------------------------------------------------------

    @property
    def part(self) -> int:
        """Bytes of the next part of a large message."""
        return PART

    def write(self, piece: Piece) -> bool:
        """Send a piece to the client in the form of its protocol; return True if there is room for more."""
        if self._socket is None:
            return False
        frames: Sequence[Frame] = piece if isinstance(piece, Sealed) else self._translated(piece)
        return self._socket.write(frames)

    def pause_reading(self, until: asyncio.Future[None]) -> None:
        """Stop receiving from the client until the future is done."""
        if self._socket is not None:
            self._socket.pause_reading(until)

    def end(self, reason: str) -> None:
        """Close the client's socket with this reason."""
        if self._socket is not None:
            self._socket.end(reason)

    def hold(self) -> None:
        """Keep messages: the socket is full."""
        self._session.outbox.pause()

    def proceed(self) -> None:
        """Send messages again."""
        self._session.outbox.resume()

    def send(self, *frames: Frame) -> None:
        """Queue frames that are never dropped; while too many wait, the client is not read."""
        self._session.send(Sealed(frames), sum(map(_size, frames)))

    async def wait_for_room(self) -> None:
        """Wait while too many frames wait for the client."""
        room = self._session.outbox.wait_for_room(CONTROL)
        if room is not None:
            await asyncio.shield(room)

    def _translated(self, piece: Piece) -> Sequence[Frame]:
        text: Any = piece[0]
        if not text.startswith(_START):
            self._status(_answer.decode(text))
            return ()
        blob = piece[1].data if len(piece) > 1 and isinstance(piece[1], BinaryFrame) else None
        key = _CONTENT.search(text)  # the first: a quote within a string is escaped
        assert key is not None
        message = _message.decode(text[len(_START) : key.start()] + b"}")
        use = self._uses.get(message.iTag)
        if use is None:
            return ()
        return use.receive(Arrived(message, memoryview(text)[key.end() : -1], blob))

    def _status(self, status: m.Status | m.Failure) -> None:
        waiting = self._commands.pop(status.id, None) if isinstance(status.id, int) else None
        if isinstance(status, m.Status):
            if isinstance(status.data, m.Ack) and waiting is not None and not waiting.done():
                waiting.set_result(None)
            elif isinstance(status.data, m.ConnectionEvent) and status.data.state == "gone":
                self._connection_gone(status.data)
            return
        error = RceError.from_info(status.error) if status.error is not UNSET else RceError(status.data)
        if waiting is not None:
            if not waiting.done():
                waiting.set_exception(error)
            return
        use = self._uses.get(str(error.info.fields.get("iTag") or error.info.item))
        if use is not None:
            use.failed(str(error.info.fields.get("msgID", "")), error)
        else:
            log.info("guest {guest}: {error}", guest=self._session.name, error=str(error))

    def _connection_gone(self, event: m.ConnectionEvent) -> None:
        """Close the client's socket if one of its uses was removed, so that the client connects again."""
        own = {side.rpartition("/")[2] for side in (event.tagA, event.tagB) if side.startswith(f"{self._tag}/")}
        for use in [self._uses[tag] for tag in own.intersection(self._uses)]:
            if use.robot:  # the robot removed it: the rest of what the client uses goes on
                self.drop(use)
                use.end(NotFound(f"{use.address}: the robot removed its interface {use.robot}"))
            else:
                self.end(f"{use.address}: environment {self.environment}, or its interface, was removed")

    # --- uses ---------------------------------------------------------------------------------------------------------

    def use(
        self,
        kind: Kind,
        address: str,
        type: str,
        receive: Callable[[Arrived], Sequence[Frame]],
        failed: Callable[[str, RceError], None],
        *,
        form: Literal["Converter", "Forwarder"] = "Converter",
        format: str = "rosbridge",
        qos: m.Qos = m.Qos(),  # noqa: B008  # immutable
        delivery: m.Delivery = m.Delivery(),  # noqa: B008  # immutable
        codec: str = "",
    ) -> Use:
        """Begin to use a topic, service or action.

        Args:
            kind: What for.
            address: ROS name.
            type: ROS type.
            receive: Returns the frames for the client, given a message.
            failed: Called with the `msgID` of a message, or an empty string, and the error.
            form: Form of the guest's interface.
            format: Its format.
            qos: Quality of service of the environment's interface; its depth is that of the guest's, too.
            delivery: Treatment of the messages on the line to the client.
            codec: Codec of the messages, which are packets then.

        Raises:
            LimitExceeded: Too many operations are in progress.
        """
        self._work.check_room()
        use = Use(f"u{next(self._tags)}", address, type, receive, failed)
        self._uses[use.tag] = use
        if kind not in (CALL, ASK):
            self.changes.begin(use.ready)
        inner = m.AddInterface(self.environment, f"{self._tag}.{use.tag}", kind.environment, type, address, qos)
        depth = m.Qos(depth=qos.depth)
        own = m.AddInterface(self._tag, use.tag, kind.own + form, type, "", depth, format, delivery, codec)
        self.run(self._make(use, inner, own))
        return use

    @property
    def _tag(self) -> str:
        return self._session.name.partition("/")[2]

    async def _make(self, use: Use, inner: m.AddInterface, own: m.AddInterface) -> None:
        """Make the interface of a use and connect it with that of a robot, or with one of the environment."""
        try:
            use.robot = await self.view.robot_interface(use.address, inner.interfaceType)
            interfaces = [own] if use.robot else [inner, own]
            other = use.robot or f"{self.environment}/{inner.interfaceTag}"
            connection = m.Connect(other, f"{self._tag}/{use.tag}")
            async with self._making:
                steps = [self._command("CN", {"addInterfaces": [each]}) for each in interfaces]
                steps.append(self._command("CX", {"connect": [connection]}))
                await asyncio.wait(steps)
            for step in steps:
                step.result()
        except RceError as error:
            self.drop(use)
            use.end(error)
        else:
            if not use.ready.done():
                use.ready.set_result(None)

    def drop(self, use: Use) -> None:
        """Stop a use: remove its interfaces, as soon as it is made."""
        if self._uses.pop(use.tag, None) is None or self._socket is None:
            return
        removal = asyncio.create_task(self._remove(use))
        self._removals.add(removal)
        self.changes.begin(removal)
        removal.add_done_callback(self._removals.discard)

    async def _remove(self, use: Use) -> None:
        await asyncio.wait([use.ready])
        added = [m.RemoveInterface(self._tag, use.tag)]
        if not use.robot:
            added.append(m.RemoveInterface(self.environment, f"{self._tag}.{use.tag}"))
        async with self._making:
            for done in [self._command("CN", {"removeInterfaces": [each]}) for each in added]:
                with suppress(RceError):  # apart, because one may not exist
                    await done

    def _command(self, type: str, items: dict[str, list[Any]]) -> asyncio.Future[None]:
        id = next(self._ids)
        done = self._commands[id] = asyncio.get_running_loop().create_future()
        done.add_done_callback(_retrieve)
        try:
            self._session.command(m.Frame(type, Raw(msgspec.json.encode(items)), id))
        except RceError as error:
            del self._commands[id]
            done.set_exception(error)
        return done

    def interface(self, use: Use) -> RobotInterface | None:
        """Return the guest's interface of a use, once it exists."""
        found = self._session.interfaces.get(use.tag)
        return found if isinstance(found, RobotInterface) else None

    def data(self, use: Use, msg_id: str, value: Raw | Buffer, failed: Callable[[RceError], None], **more: Any) -> None:
        """Send a message of the client; `more` are fields of the data message.

        Args:
            use: The use, which is ready.
            msg_id: Id of the message.
            value: JSON value, or CDR if it is no Raw.
            failed: Called with the error if it cannot be sent.
            more: Fields of the data message.
        """
        blobs: dict[str, Buffer] = {}
        if isinstance(value, Raw):
            message = m.DataMessage(use.tag, use.type, msg_id, msg=value, **more)
        else:
            blobs[BLOB] = value
            message = m.DataMessage(use.tag, use.type, msg_id, blob=_BLOB_VALUE, **more)
        try:
            task = self.endpoint.data(self._session, message, blobs)
        except RceError as error:
            failed(error)
            return
        if task is not None:
            size = len(memoryview(value))
            self._conversions.add(task, size, lambda error: failed(error) if error is not None else None)

    @property
    def name(self) -> str:
        """Name of the guest."""
        return self._session.name

    def run(self, work: Coroutine[Any, Any, None], size: int = 0) -> None:
        """Run a coroutine, which holds `size` bytes of the client's data, until the client leaves.

        Raises:
            LimitExceeded: Too many coroutines run.
        """
        self._work.run(work, size)

    def check_room(self) -> None:
        """Raise LimitExceeded if too many coroutines run: `use` and `run` would refuse another."""
        self._work.check_room()


BLOB = "0" * 32
_BLOB_VALUE = Raw(b'"' + BLOB.encode() + b'"')


def _size(frame: Frame) -> int:
    parts = (frame.head, frame.data) if isinstance(frame, BinaryFrame | TextFrame) else (frame,)
    return sum(map(len, parts))


def _retrieve(done: asyncio.Future[None]) -> None:
    with suppress(RceError, asyncio.CancelledError):
        done.result()
