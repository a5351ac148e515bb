"""A robot's session: connected again whenever the socket breaks, and the commands that are under way on it.

A command whose socket broke before its answer came is sent again on the next one; when the answer then says that the
work was done already, it counts as done. So a command ends with its result, with TimedOut, or with why the robot is
not let in any more.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import random
from collections.abc import Iterable, Iterator, Mapping
from contextlib import aclosing
from dataclasses import dataclass
from typing import Protocol

from msgspec import UNSET

from rce.client.address import Address
from rce.client.commands import frame_of, repetition_done
from rce.client.connection import Connection, Incoming, Message
from rce.client.values import encode
from rce.errors import Forbidden, InternalError, InvalidRequest, NotFound, RceError, TimedOut, Unauthorized, Unavailable
from rce.messages import Ack, Command, Failure, FrameId, StatusData
from rce.messages import Session as SessionStatus

COMMANDS = " commands"  # as a source of the outbox; no tag has a blank
MIN_DELAY, MAX_DELAY = 0.1, 10.0  # seconds between attempts to reconnect, after a first one at once

log = logging.getLogger("rce.client")


class Listener(Protocol):
    """Who hears what a session brings."""

    def received(self, message: Message) -> None: ...

    def status(self, status: StatusData) -> None: ...

    def failed(self, error: RceError, frame_id: FrameId | None) -> None:
        """An ER, with the id of the data message that it answers, if any; or a fault of the server's."""

    def lost(self, reason: str) -> None: ...

    def back(self, resumed: bool, interfaces: Mapping[str, bool]) -> None:
        """Connected again; `interfaces` has the statuses of those that a resumed session still has."""

    def declared(self) -> Iterable[Command]:
        """What is to be declared again on a connection that did not resume."""

    def ended(self, error: RceError | None) -> None:
        """There will be no other connection."""


@dataclass(slots=True, eq=False)
class Request:
    """A command under way; `restores` if the session itself sent it to declare something again."""

    command: Command
    done: asyncio.Future[None]
    restores: bool
    attempts: int = 0


class Session:
    """Open it once; it stays until `close`, or until the platform refuses the robot."""

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
        self._restoring: set[asyncio.Task[None]] = set()
        self._error: RceError = Unavailable("the robot is not connected")

    async def open(self) -> None:
        """Connect, or raise why that is not possible. Once only."""
        if self._opened:
            raise InvalidRequest("this robot has been opened before: make a new one")
        connection = await self._connect()
        self._opened = True
        self._begin(connection)
        self._keeper = asyncio.create_task(self._keep(connection), name=f"rce session of {self._address.robot}")

    async def close(self) -> None:
        """Send what is queued and leave for good; commands under way raise Unavailable."""
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

    async def carry_out(self, command: Command) -> None:
        """Send a command and wait for its end. Raises what the answer says.

        Commands leave, and are carried out, in the order of these calls.
        """
        if self._keeper is None:
            raise self._error
        await self._outcome(*self._submit(command, restores=False))

    def _submit(self, command: Command, restores: bool) -> tuple[int, Request]:
        number = next(self._ids)
        request = Request(command, asyncio.get_running_loop().create_future(), restores)
        self._requests[number] = request
        if self.connection is not None:
            self._send(self.connection, number, request)
        return number, request

    async def _outcome(self, number: int, request: Request) -> None:
        try:
            async with asyncio.timeout(self._timeout):
                await request.done
        except TimeoutError:
            what = type(request.command).__name__
            raise TimedOut(f"{what} was not answered within {self._timeout:g} s") from None
        finally:
            self._requests.pop(number, None)

    def _send(self, connection: Connection, number: FrameId, request: Request) -> None:
        request.attempts += 1
        acknowledged = "ack" in connection.features
        frame = frame_of(request.command) | ({"id": number} if acknowledged else {})

        def sent() -> None:
            if not acknowledged and not request.done.done():
                request.done.set_result(None)

        connection.put_text(COMMANDS, encode(frame), sent)

    async def _connect(self) -> Connection:
        """The endpoint that may still hold the session, else the one that the entry names."""
        if self._token:
            try:
                return await Connection.open(self._address, self._endpoint, self._token)
            except (Unavailable, InvalidRequest) as error:
                log.info("%s: %s; asking the entry", self._address.robot, error)
        return await Connection.open(self._address, await self._address.locate(), self._token)

    def _begin(self, connection: Connection) -> None:
        self._token, self._endpoint = connection.session.token, connection.endpoint
        self.connection = connection

    async def _keep(self, connection: Connection) -> None:
        try:
            while True:
                async with aclosing(connection.receive()) as frames_in:
                    async for incoming in frames_in:
                        self._take(incoming)
                self._lose(connection.reason)
                connection = await self._reconnect()
                self._begin(connection)
                self._listener.back(connection.session.resumed, connection.session.interfaces)
                self._restore(connection)
        except RceError as error:
            self._end(error)
        except Exception as error:
            self._end(InternalError(f"the client failed: {error!r}"))  # so that nobody waits for ever
            raise

    async def _reconnect(self) -> Connection:
        """A new connection, however long that takes. Unauthorized, Forbidden, NotFound: trying again does not help."""
        for delay in delays():
            await asyncio.sleep(delay)
            try:
                return await self._connect()
            except (Unauthorized, Forbidden, NotFound):
                raise
            except RceError as error:
                log.info("%s: not connected yet: %s", self._address.robot, error)
        raise AssertionError("the delays do not end")

    def _lose(self, reason: str) -> None:
        self.connection = None
        for number, request in list(self._requests.items()):
            if request.restores:  # what is missing then is found out anew
                del self._requests[number]
        self._stop_restoring()
        self._listener.lost(reason)

    def _restore(self, connection: Connection) -> None:
        """Declare again what is gone, then repeat the commands under way, all in their order."""
        under_way = list(self._requests.items())
        if not connection.session.resumed:
            for command in self._listener.declared():
                number, request = self._submit(command, restores=True)
                task = asyncio.create_task(self._redeclare(number, request))
                self._restoring.add(task)
                task.add_done_callback(self._restoring.discard)
        for each, waiting in under_way:
            self._send(connection, each, waiting)

    async def _redeclare(self, number: int, request: Request) -> None:
        for delay in delays():
            try:
                return await self._outcome(number, request)
            except Unavailable:
                await asyncio.sleep(delay)
                number, request = self._submit(request.command, restores=True)
            except RceError as error:
                return self._listener.failed(error, None)

    def _take(self, incoming: Incoming) -> None:
        if isinstance(incoming, Message):
            self._listener.received(incoming)
        elif isinstance(incoming, RceError):
            self._listener.failed(incoming, None)
        elif isinstance(incoming, Failure):
            self._failure(incoming)
        elif isinstance(incoming.data, Ack):
            request = self._requests.get(incoming.id) if incoming.id is not UNSET else None
            if request is not None and not request.done.done():
                request.done.set_result(None)
        elif not isinstance(incoming.data, SessionStatus):
            self._listener.status(incoming.data)

    def _failure(self, failure: Failure) -> None:
        error = error_of(failure)
        request = self._requests.get(failure.id) if failure.id is not UNSET else None
        if request is None:
            self._listener.failed(error, None if failure.id is UNSET else failure.id)
        elif request.done.done():
            return
        elif (request.restores or request.attempts > 1) and repetition_done(request.command, error):
            request.done.set_result(None)
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


def delays() -> Iterator[float]:
    """Seconds to wait before each attempt: none, then doubling, with jitter so that many robots do not come at once."""
    yield 0.0
    delay = MIN_DELAY
    while True:
        yield delay * random.uniform(0.5, 1.0)
        delay = min(2 * delay, MAX_DELAY)


def error_of(failure: Failure) -> RceError:
    """What an ER says; the original gives a bare sentence, of which only the beginning tells a kind."""
    if failure.error is not UNSET:
        return RceError.from_info(failure.error)
    return (InvalidRequest if failure.data.startswith("Invalid Request") else RceError)(failure.data)
