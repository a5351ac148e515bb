"""Listening sockets of aiohttp servers: where they are bound, their limits and how they stop."""

from __future__ import annotations

import asyncio
import contextvars
import logging
import re
import socket
import ssl
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple, cast

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from rce.errors import InvalidRequest
from rce.net.listener import BACKLOG, Listener, bind
from rce.net.pending_logins import PendingLogin
from rce.net.tls import public_tls_context

IDLE_TIMEOUT = 60.0  # seconds that a connection may take for the head of its first or next request
MAX_LINE = 16_384  # bytes of the request line, and of one header
SHUTDOWN_TIMEOUT = 1.0  # seconds for which requests in progress may go on while the server stops
UNREAD_TIMEOUT = 60.0  # seconds for which a client may read nothing of a response
LINGERING_TIME = 2.0  # seconds for which the rest of a refused body is read, so that the client gets the answer
LIMITS: dict[str, Any] = {
    "access_log": None,
    "keepalive_timeout": IDLE_TIMEOUT,
    "lingering_time": LINGERING_TIME,
    "max_line_size": MAX_LINE,
    "max_field_size": MAX_LINE,
    "auto_decompress": False,  # nothing is expected to come compressed, and it could expand without bound
}
OPTIONS = {"tcp": {"port", "interface", "backlog"}}
OPTIONS["ssl"] = OPTIONS["tcp"] | {"privateKey", "certKey"}

Handler = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]

_pending: contextvars.ContextVar[PendingLogin | None] = contextvars.ContextVar("pending", default=None)


class Endpoint(NamedTuple):
    """Address at which a server listens; port 0 takes a free one, and `tls` makes it https."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None
    backlog: int = BACKLOG

    @property
    def scheme(self) -> str:
        """`http` or `https`."""
        return "http" if self.tls is None else "https"


def parse_endpoint(description: str) -> Endpoint:
    """Return the address that a Twisted server endpoint description stands for, with its certificate loaded.

    Raises:
        InvalidRequest: The description is malformed, of another kind than `tcp:` and `ssl:`, or has an option that is
            not supported; or the certificate cannot be loaded.
    """
    kind, options = _split(description)
    unknown = options.keys() - OPTIONS[kind]
    if unknown:
        raise _invalid(description, f"{kind}: has no option {min(unknown)}")
    numbers = {}
    for name, default, largest in (("port", "", 65_535), ("backlog", str(BACKLOG), 65_535)):
        text = options.get(name, default)
        if not re.fullmatch("[0-9]{1,5}", text) or int(text) > largest:
            raise _invalid(description, f"{name} must be a number from 0 to {largest}")
        numbers[name] = int(text)
    tls = None
    if kind == "ssl":
        if "certKey" not in options:
            raise _invalid(description, "ssl: needs certKey, a PEM file with the certificate")
        tls = public_tls_context(options["certKey"], options.get("privateKey", ""))
    return Endpoint(options.get("interface") or "0.0.0.0", numbers["port"], tls, numbers["backlog"])


def _split(description: str) -> tuple[str, dict[str, str]]:
    """Return the kind and the options; a backslash escapes a colon, and the port may come first without its name."""
    words = re.findall(r"(?:[^:\\]|\\.)+", description)
    if not words or words[0] not in OPTIONS or ":".join(words) != description:
        raise _invalid(description, "it must begin with tcp: or ssl:, and the port")
    options: dict[str, str] = {}
    for position, word in enumerate(words[1:]):
        name, equals, value = word.partition("=")
        if not equals:
            if position:
                raise _invalid(description, f"{word!r} is not of the form name=value")
            name, value = "port", word
        options[name] = re.sub(r"\\(.)", r"\1", value)
    return words[0], options


def _invalid(description: str, reason: str) -> InvalidRequest:
    return InvalidRequest(
        f"{description!r} is no Twisted server endpoint such as tcp:9000 or tcp:9000:interface=127.0.0.1: {reason}"
    )


def serve_handler(handler: Handler) -> web.ServerRunner:
    """Return a runner that gives each request to one handler, and cancels it when the client disconnects."""
    server = web.Server(handler, handler_cancellation=True, **LIMITS)
    return web.ServerRunner(server, shutdown_timeout=SHUTDOWN_TIMEOUT)


def serve_application(application: web.Application, **options: Any) -> web.AppRunner:
    """Return a runner of an application with the same limits; `options` are those of `web.AppRunner`."""
    options = {"shutdown_timeout": SHUTDOWN_TIMEOUT} | LIMITS | options
    return web.AppRunner(application, handle_signals=False, **options)


async def listen(runner: web.BaseRunner, endpoint: Endpoint) -> tuple[str, int]:
    """Start the runner at an address, and return the host and port that it got. `runner.cleanup` stops it.

    Raises:
        Unavailable: The port is in use or cannot be bound.
    """
    listening = bind(endpoint.host, endpoint.port, endpoint.backlog)
    host, port = listening.getsockname()[:2]
    try:
        await runner.setup()
        await _Site(runner, listening, endpoint).start()
    except BaseException:
        listening.close()
        raise
    return host, port


def logged_in() -> None:
    """Note that the client of the current request has logged in, so that its connection no longer counts as pending."""
    pending = _pending.get()
    if pending is not None:
        pending.end()


class _Site(web.BaseSite):
    """Site whose connections count for their addresses until their clients log in."""

    def __init__(self, runner: web.BaseRunner, listening: socket.socket, endpoint: Endpoint) -> None:
        super().__init__(runner)
        self._listening = listening
        self._endpoint = endpoint

    @property
    def name(self) -> str:
        return f"{self._endpoint.scheme}://{self._endpoint.host}:{self._endpoint.port}"

    async def start(self) -> None:
        await super().start()
        make = self._runner.server
        assert make is not None
        self._listener = Listener(self._listening, lambda pending: _Connection(make(), pending), self._endpoint.tls)

    async def stop(self) -> None:
        self._listener.close()
        await super().stop()


class _Connection(asyncio.Protocol):
    """Passes everything on to aiohttp; closes a connection whose client does not read its responses."""

    def __init__(self, handler: asyncio.Protocol, pending: PendingLogin) -> None:
        self._handler = handler
        self._pending = pending
        self._transport: asyncio.Transport
        self._unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)  # uvloop's is no subclass of it
        context = contextvars.copy_context()  # that of all requests of this connection
        context.run(_pending.set, self._pending)
        context.run(self._handler.connection_made, transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._pending.end()
        self._stop_watching()
        self._handler.connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        self._handler.data_received(data)

    def eof_received(self) -> bool | None:
        return self._handler.eof_received()

    def pause_writing(self) -> None:
        self._handler.pause_writing()
        self._watch()

    def resume_writing(self) -> None:
        self._stop_watching()
        self._handler.resume_writing()

    def _watch(self) -> None:
        size = self._transport.get_write_buffer_size()
        self._unread = asyncio.get_running_loop().call_later(UNREAD_TIMEOUT, self._check, size)

    def _stop_watching(self) -> None:
        if self._unread is not None:
            self._unread.cancel()

    def _check(self, before: int) -> None:
        if self._transport.get_write_buffer_size() < before:
            self._watch()
        else:
            self._transport.abort()


def _is_defect(record: logging.LogRecord) -> bool:
    """Return whether aiohttp logs a defect.

    A malformed request is none, and its line may have credentials in it; nor is a client that disconnects before its
    request is complete.
    """
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError | ConnectionResetError)


logging.getLogger("aiohttp.server").addFilter(_is_defect)
