"""Session of a robot: reconnects whenever the socket breaks and carries its commands across connections.

A command whose socket breaks before the answer is sent again on the next connection. If the answer to the repetition
says that the work was done already, the command has succeeded. So a command ends with its own result, with TimedOut, or
with the error by which the platform refused the robot.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import random
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import aclosing
from dataclasses import dataclass
from typing import Protocol

from msgspec import UNSET, UnsetType

from rce.client.address import Address
from rce.client.commands import already_done, frame_of
from rce.client.connection import Connection, Incoming, Message
from rce.client.events import PlatformEvent
from rce.client.values import encode
from rce.errors import (
    AlreadyExists,
    Forbidden,
    InternalError,
    InvalidRequest,
    NotConnected,
    NotFound,
    RceError,
    TimedOut,
    Unauthorized,
    Unavailable,
    UnknownType,
)
from rce.protocol.messages import Ack, Command, Failure, FrameId, InterfaceStatus, Session

COMMANDS = " commands"  # their source in the outbox; a tag cannot contain a space
MAY_COME_BACK = (NotFound, UnknownType, TimedOut)  # errors of declarations whose peer or environment is away
NAME_WAIT = 30.0  # seconds; within 20 s the platform closes a socket that is silent
MIN_DELAY, MAX_DELAY = 0.1, 10.0  # seconds between attempts to reconnect; the first attempt is immediate

log = logging.getLogger("rce.client")


class Listener(Protocol):
    """Receiver of the events of a session."""

    def message_received(self, message: Message) -> None:
        """Handle a data message."""

    def status_received(self, status: InterfaceStatus | PlatformEvent) -> None:
        """Handle a status frame that is not about the session or a command."""

    def error_received(self, error: RceError) -> None:
        """Handle an error that answers no command."""

    def disconnected(self, reason: str) -> None:
        """Handle the loss of the socket; the session is reconnecting."""

    def reconnected(self, resumed: bool, interfaces: Mapping[str, bool]) -> None:
        """Handle a new connection; `interfaces` has the connection status of a resumed session's interfaces by tag."""

    def declarations(self) -> Iterable[Command]:
        """Return the commands that restore the robot's interfaces and connections in a new session."""

    def ended(self, error: RceError | None) -> None:
        """Handle the end of the session: closed by the application (None) or by this error."""


@dataclass(slots=True, eq=False)
class Request:
    """Command without an answer yet; `restores` marks a declaration that the session itself repeats."""

    command: Command
    done: asyncio.Future[Ack]
    restores: bool
    attempts: int = 0


class ClientSession:
    """Session that lasts from `open` until `close`, or until the platform refuses the robot."""

    def __init__(self, address: Address, listener: Listener, timeout: float) -> None:
        self.connection: Connection | None = None
        self._address = address
        self._listener = listener
        self._timeout = timeout
        self._requests: dict[FrameId, Request] = {}
        self._ids = itertools.count(1)
        self._token = ""
        self._endpoint = ""
        self._opened = False
        self._keeper: asyncio.Task[None] | None = None
        self._restoring: dict[asyncio.Task[None], Command] = {}
        self._unrestored: list[Command] = []  # declarations that were not answered when the socket broke
        self._error: RceError = Unavailable("the robot is not connected: call open() first")

    async def open(self, wait: float) -> None:
        """Connect for the first time; try again for `wait` seconds while the name is in use.

        Raises:
            InvalidRequest: This session has been opened before.
            RceError: The connection failed; see `Address.dial`.
        """
        if self._opened:
            raise InvalidRequest("this robot has been opened before: make a new one")
        connection = await self._connect_when_free(wait)
        self._opened = True
        self._adopt(connection)
        self._keeper = asyncio.create_task(self._keep(connection), name=f"rce session of {self._address.robot}")

    async def close(self) -> None:
        """Send the queued frames and end the session; pending commands raise Unavailable."""
        keeper, connection = self._keeper, self.connection
        if keeper is None:
            return
        if connection is not None:
            await connection.flush()
        keeper.cancel()
        await asyncio.gather(keeper, return_exceptions=True)
        if self.connection is not None:
            await self.connection.close()
        self._end(None)

    async def execute(self, command: Command) -> Ack:
        """Send a command, wait until it has been executed, and return the acknowledgement.

        Commands are sent and executed in the order of these calls. While offline, a command waits for the next
        connection.

        Raises:
            TimedOut: There was no answer within the session's timeout.
            Unavailable: The session is not open.
            RceError: The error with which the platform answered.
        """
        if self._keeper is None:
            raise self._error
        return await self._outcome(*self._submit(command, restores=False))

    def _submit(self, command: Command, restores: bool) -> tuple[FrameId, Request]:
        number: FrameId = next(self._ids)
        request = Request(command, asyncio.get_running_loop().create_future(), restores)
        self._requests[number] = request
        if self.connection is not None:
            self._send(self.connection, number, request)
        return number, request

    async def _outcome(self, number: FrameId, request: Request) -> Ack:
        try:
            async with asyncio.timeout(self._timeout):
                return await request.done
        except TimeoutError:
            name = type(request.command).__name__
            raise TimedOut(f"{name} was not answered within {self._timeout:g} s") from None
        finally:
            self._requests.pop(number, None)

    def _send(self, connection: Connection, number: FrameId, request: Request) -> None:
        request.attempts += 1
        acknowledged = "ack" in connection.features
        frame = frame_of(request.command) | ({"id": number} if acknowledged else {})

        def on_sent() -> None:
            if not acknowledged and not request.done.done():
                request.done.set_result(Ack())

        connection.put_text(COMMANDS, encode(frame), on_sent)

    async def _connect_when_free(self, wait: float) -> Connection:
        until, warned = time.monotonic() + wait, False
        for delay in backoff_delays():
            await asyncio.sleep(min(delay, 1.0))
            try:
                return await self._connect()
            except AlreadyExists as error:
                if time.monotonic() >= until:
                    raise
                if delay and not warned:  # at the first attempt the platform may not have noticed the end of a program
                    log.warning("%s; trying again for %g s", error, wait)
                    warned = True
        raise AssertionError("the delays are endless")

    async def _connect(self) -> Connection:
        """Connect to the endpoint that may still hold the session, else to the one that the entry assigns."""
        if self._token:
            try:
                return await Connection.open(self._address, self._endpoint, self._token)
            except (Unavailable, InvalidRequest) as error:
                log.info("%s: %s; asking the entry for an endpoint", self._address.robot, error)
        endpoint = await self._address.locate(patient=bool(self._token))
        return await Connection.open(self._address, endpoint, self._token)

    def _adopt(self, connection: Connection) -> None:
        self._token, self._endpoint = connection.session.token, connection.endpoint
        self.connection = connection

    async def _keep(self, connection: Connection) -> None:
        try:
            while True:
                async with aclosing(connection.receive()) as incoming_frames:
                    async for incoming in incoming_frames:
                        self._handle(incoming)
                self._disconnected(connection.reason)
                connection = await self._reconnect()
                self._adopt(connection)
                self._listener.reconnected(connection.session.resumed, connection.session.interfaces)
                self._restore(connection)
        except RceError as error:
            self._end(error)
        except Exception as error:
            self._end(InternalError(f"the client failed: {error!r}"))  # or pending commands would wait for ever
            raise

    async def _reconnect(self) -> Connection:
        """Retry until a connection is made; raise only errors that no retry can resolve."""
        for delay in backoff_delays():
            await asyncio.sleep(delay)
            try:
                return await self._connect()
            except (Unauthorized, Forbidden, NotFound):
                raise
            except RceError as error:
                log.info("%s: not connected yet: %s", self._address.robot, error)
        raise AssertionError("the delays are endless")

    def _disconnected(self, reason: str) -> None:
        self.connection = None
        for number, request in list(self._requests.items()):
            if request.restores:  # the next connection determines anew which declarations are missing
                del self._requests[number]
        self._unrestored = list(self._restoring.values())
        self._stop_restoring()
        self._listener.disconnected(reason)

    def _restore(self, connection: Connection) -> None:
        """Declare again what the platform no longer has, then repeat the pending commands, all in their order."""
        pending = list(self._requests.items())
        missing = list(self._listener.declarations())
        if connection.session.resumed:
            missing = [command for command in self._unrestored if command in missing]
        for command in missing:
            number, request = self._submit(command, restores=True)
            task = asyncio.create_task(self._redeclare(number, request))
            self._restoring[task] = command
            task.add_done_callback(self._restoring.pop)
        for number, request in pending:
            self._send(connection, number, request)

    async def _redeclare(self, number: FrameId, request: Request) -> None:
        """Wait for the answer to a declaration; repeat it while what it needs, as the peer, is not back yet."""
        reported = False
        for delay in backoff_delays():
            try:
                await self._outcome(number, request)
                return
            except Unavailable:
                pass
            except RceError as error:
                if not reported:
                    self._listener.error_received(error)
                reported = True
                if not isinstance(error, MAY_COME_BACK):
                    return
            await asyncio.sleep(delay)
            if request.command not in self._listener.declarations():
                return  # the application does not want it any more
            number, request = self._submit(request.command, restores=True)

    def _handle(self, incoming: Incoming) -> None:
        if isinstance(incoming, Message):
            self._listener.message_received(incoming)
        elif isinstance(incoming, RceError):
            self._listener.error_received(incoming)
        elif isinstance(incoming, Failure):
            self._handle_failure(incoming)
        elif isinstance(incoming.data, Ack):
            self._handle_ack(incoming.id, incoming.data)
        elif not isinstance(incoming.data, Session):
            self._listener.status_received(incoming.data)

    def _handle_ack(self, frame_id: FrameId | UnsetType, ack: Ack) -> None:
        if frame_id is UNSET or self._answer_message(frame_id, None):
            return
        request = self._requests.get(frame_id)
        if request is not None and not request.done.done():
            request.done.set_result(ack)

    def _answer_message(self, frame_id: FrameId, error: RceError | None) -> bool:
        return self.connection is not None and self.connection.answer(frame_id, error)

    def _handle_failure(self, failure: Failure) -> None:
        error = error_of(failure)
        if failure.id is not UNSET and self._answer_message(failure.id, error) and isinstance(error, NotConnected):
            return  # the publisher sends the message again
        request = self._requests.get(failure.id) if failure.id is not UNSET else None
        if request is None:
            self._listener.error_received(error)
        elif request.done.done():
            return
        elif (request.restores or request.attempts > 1) and already_done(request.command, error):
            request.done.set_result(Ack())
        else:
            request.done.set_exception(error)

    def _stop_restoring(self) -> None:
        for task in self._restoring:
            task.cancel()

    def _end(self, error: RceError | None) -> None:
        self._stop_restoring()
        self.connection, self._keeper = None, None
        self._error = error or Unavailable("the robot has been closed")
        for request in self._requests.values():
            if not request.done.done():
                request.done.set_exception(self._error)
        self._listener.ended(error)


def backoff_delays() -> Iterator[float]:
    """Yield the seconds to wait before each attempt: zero, then exponential backoff with jitter, without end.

    The jitter keeps many robots from reconnecting at the same moment.
    """
    yield 0.0
    delay = MIN_DELAY
    while True:
        yield delay * random.uniform(0.5, 1.0)
        delay = min(2 * delay, MAX_DELAY)


def error_of(failure: Failure) -> RceError:
    """Return the error of an ER frame.

    A server of the original sends a bare sentence; only its beginning distinguishes one kind of error.
    """
    if failure.error is not UNSET:
        return RceError.from_info(failure.error)
    return (InvalidRequest if failure.data.startswith("Invalid Request") else RceError)(failure.data)
