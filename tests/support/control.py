"""Control connections and calls for tests: a joiner that admits everybody, and pairs of connected ends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

import msgspec
from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort

from rce.control.calls.call import Call, result_type
from rce.control.calls.joining import Hello, Welcome
from rce.control.calls.robots import Execute
from rce.control.client import connect
from rce.control.connection import Control, Handlers
from rce.control.pages import Question, decode_pages, encode, encode_pages
from rce.control.server import listen
from rce.errors import ErrorInfo, RceError
from rce.net.tls import Tls
from rce.protocol.messages import Command

HELLO = Hello("container", "m1", "token", "1")
LOOPBACK = "tcp:0:interface=127.0.0.1"
TIMEOUT = 20.0
R = TypeVar("R")


class OpenJoiner:
    """Admits every process; its calls are answered by `handlers`."""

    def __init__(self, handlers: Handlers | None = None) -> None:
        self.handlers = handlers or Handlers()
        self.joined: asyncio.Queue[Control] = asyncio.Queue()

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        return Welcome("credential"), self.handlers, self.joined.put_nowait


class Listener:
    """A listening port of control connections; `description` is its client endpoint."""

    def __init__(self, reactor: ReactorBase, joiner: OpenJoiner, port: IListeningPort) -> None:
        self.reactor = reactor
        self.joiner = joiner
        self.port: int = port.getHost().port  # type: ignore[misc]  # zope declares it without self
        self.description = f"tcp:127.0.0.1:{self.port}"

    async def pair(self, handlers: Handlers, tls: Tls | None = None, hello: Hello = HELLO) -> tuple[Control, Control]:
        """Connect; return the connecting end, whose calls `handlers` answer, and the accepting end."""
        client, _ = await connect(self.reactor, self.description, hello, handlers, tls)
        return client, await asyncio.wait_for(self.joiner.joined.get(), TIMEOUT)


@asynccontextmanager
async def listening(
    reactor: ReactorBase,
    handlers: Handlers | None = None,
    tls: Tls | None = None,
    joiner: OpenJoiner | None = None,
) -> AsyncIterator[Listener]:
    """Accept control connections at a free port.

    Calls over them are answered by `handlers`, unless there is another `joiner`.
    """
    joiner = joiner or OpenJoiner(handlers)
    port = await listen(reactor, LOOPBACK, joiner, tls)
    try:
        yield Listener(reactor, joiner, port)
    finally:
        await port.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]


async def closed(client: Control, server: Control) -> None:
    """Close the connecting end and wait until the accepting end has noticed."""
    client.close()
    await asyncio.wait_for(server.lost, TIMEOUT)


async def answer(handlers: Handlers, call: Call[R]) -> R:
    """Return the answer to a call without a connection; raise its error."""
    found = await handlers.answer(Question(type(call).__name__, "", 0, encode(call)))
    if not found.good:
        raise RceError.from_info(msgspec.msgpack.decode(found.value, type=ErrorInfo))
    return msgspec.msgpack.decode(found.value, type=result_type(type(call)))


def execute_round_trip(command: Command) -> Command:
    """Encode a command as the call of a Robot endpoint to the Master, and decode it again."""
    return decode_pages(encode_pages(Execute.of("ann/r1", command)), Execute).commands[0].unpack()
