"""Server-sent events: answers that go on until the client disconnects or its credentials are revoked."""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from typing import Any, NamedTuple

import msgspec
from aiohttp import web
from msgspec import Struct
from twisted.logger import Logger

from master.access.guard import Guard
from master.access.rights import Principal
from rce.errors import LimitExceeded, RceError

MEDIA_TYPE = "text/event-stream"
HEARTBEAT = 15.0  # seconds between comments, so that no proxy takes the connection for dead
CLOSE_TIMEOUT = 1.0  # seconds for the end of a stream that its client does not read
MAX_STREAMS = 20  # of one user
log = Logger()
COMMENT = b":\n\n"


class ServerSentEvent(NamedTuple):
    """One event; `id` and `name` may be empty."""

    id: str
    name: str
    data: Struct


class EventStreams:
    """Open streams, and their number for each user."""

    def __init__(self, guard: Guard) -> None:
        self._guard = guard
        self._count: Counter[str] = Counter()
        self._open: dict[EventStream, asyncio.Task[Any]] = {}

    def stream(self, principal: Principal, events: AsyncIterator[ServerSentEvent]) -> EventStream:
        """Return a stream of these events.

        Raises:
            LimitExceeded: The user has too many streams open.
        """
        if self._count[principal.user] >= MAX_STREAMS:
            raise LimitExceeded(f"{principal.user} has {MAX_STREAMS} streams open already", limit=MAX_STREAMS)
        return EventStream(self, principal, events)

    @contextlib.contextmanager
    def holding(self, stream: EventStream) -> Iterator[None]:
        """Count a stream while it is open, and end it when the credentials of its principal are revoked."""
        self._count[stream.principal.user] += 1
        task = asyncio.current_task()
        assert task is not None
        self._open[stream] = task
        release = self._guard.hold(stream.principal, lambda reason: stream.end())
        try:
            yield
        finally:
            release()
            del self._open[stream]
            self._count[stream.principal.user] -= 1

    async def stop(self) -> None:
        """End all streams: the server stops."""
        for stream in self._open:
            stream.end()
        if self._open:
            await asyncio.wait(self._open.values(), timeout=2 * CLOSE_TIMEOUT)


class EventStream:
    """One answer of server-sent events. The next event is not asked for while the client does not read."""

    def __init__(self, streams: EventStreams, principal: Principal, events: AsyncIterator[ServerSentEvent]) -> None:
        self.principal = principal
        self._streams = streams
        self._events = events
        self._sending: asyncio.Task[None] | None = None

    def end(self) -> None:
        """End the stream before its events do."""
        if self._sending is not None:
            self._sending.cancel()

    async def send(self, request: web.BaseRequest, headers: dict[str, str]) -> web.StreamResponse:
        """Send the events until they end, the stream is ended or the client disconnects."""
        response = web.StreamResponse(headers={**headers, "Content-Type": MEDIA_TYPE, "Cache-Control": "no-store"})
        await response.prepare(request)
        if request.method == "HEAD":
            return response
        self._sending = asyncio.ensure_future(self._send(response))
        transport = request.transport
        with self._streams.holding(self):
            try:
                await asyncio.wait([self._sending])
            finally:
                self._sending.cancel()
        try:
            if not self._sending.cancelled():
                self._sending.result()
            async with asyncio.timeout(CLOSE_TIMEOUT):
                await response.write_eof()
        except ConnectionError:
            raise  # the client disconnected
        except Exception as error:  # noqa: BLE001  # the response has begun: it can only be broken off
            if not isinstance(error, TimeoutError):
                log.failure("defect in an event stream")
            if transport is not None:
                transport.abort()
        return response

    async def _send(self, response: web.StreamResponse) -> None:
        await response.write(COMMENT)  # the client knows at once that the stream is open
        heartbeat = asyncio.ensure_future(_send_heartbeats(response))
        try:
            async for event in self._events:
                await response.write(_encode(event))
        except RceError as error:
            await response.write(_encode(ServerSentEvent("", "error", error.info)))
        finally:
            heartbeat.cancel()


async def _send_heartbeats(response: web.StreamResponse) -> None:
    try:
        while True:
            await asyncio.sleep(HEARTBEAT)
            await response.write(COMMENT)
    except ConnectionError:
        pass  # the server cancels the request


def _encode(event: ServerSentEvent) -> bytes:
    head = (f"id: {event.id}\n" if event.id else "") + (f"event: {event.name}\n" if event.name else "")
    return head.encode() + b"data: " + msgspec.json.encode(event.data) + b"\n\n"
