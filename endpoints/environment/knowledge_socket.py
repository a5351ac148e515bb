"""UNIX socket at which programs of the environment use the knowledge service; see `rce.api.knowledge_requests`."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import msgspec

from rce.api.knowledge_requests import MAX_FRAME, KnowledgeAnswer, KnowledgeRequest, Reply
from rce.errors import MALFORMED, InvalidRequest, LimitExceeded, RceError
from rce.net.sockets import bind_unix_socket

MOST = 16  # connections at a time; those beyond are answered with an error
PATIENCE = 60.0  # seconds for a request to arrive

Ask = Callable[[KnowledgeRequest], Awaitable[KnowledgeAnswer]]


class KnowledgeSocket:
    """Server that passes requests to the Master."""

    def __init__(self, ask: Ask) -> None:
        """Serve nothing yet; `ask` passes a request on."""
        self._ask = ask
        self._server: asyncio.Server | None = None
        self._open: set[asyncio.Task[None]] = set()

    async def listen(self, path: Path) -> None:
        """Listen at a path.

        Raises:
            OSError: The socket cannot be created.
        """
        self._server = await asyncio.start_unix_server(self._accept, sock=bind_unix_socket(path, 0o600))

    async def close(self) -> None:
        """Close the socket and all connections."""
        if self._server is not None:
            self._server.close()
        for task in self._open:
            task.cancel()
        await asyncio.gather(*self._open, return_exceptions=True)

    def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.create_task(self._serve(reader, writer, len(self._open) >= MOST))
        self._open.add(task)
        task.add_done_callback(self._open.discard)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, crowded: bool) -> None:
        try:
            with suppress(OSError, asyncio.IncompleteReadError, TimeoutError):  # the program has left, or is silent
                while True:
                    reply = await self._reply(reader, crowded)
                    writer.write(len(reply).to_bytes(4, "big") + reply)
                    await writer.drain()
        finally:
            writer.close()

    async def _reply(self, reader: asyncio.StreamReader, crowded: bool) -> bytes:
        """Receive a request and return the reply.

        Raises:
            OSError, IncompleteReadError, TimeoutError: No request came.
        """
        async with asyncio.timeout(PATIENCE):
            size = int.from_bytes(await reader.readexactly(4), "big")
            if size > MAX_FRAME:
                raise ConnectionAbortedError  # what follows cannot be told apart
            data = await reader.readexactly(size)
        try:
            if crowded:
                raise LimitExceeded(f"more than {MOST} programs of this environment use the knowledge service at once")
            reply = Reply(await self._ask(_decode(data)))
        except RceError as error:
            reply = Reply(error=error.info)
        return msgspec.msgpack.encode(reply)


def _decode(data: bytes) -> KnowledgeRequest:
    try:
        request: KnowledgeRequest = msgspec.msgpack.decode(data, type=KnowledgeRequest)
    except MALFORMED as error:
        raise InvalidRequest(f"no request to the knowledge service: {error}") from None
    return request
