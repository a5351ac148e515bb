"""WebSocket of a robot: handshakes that fail, proxies, and the end of a connection."""

from __future__ import annotations

import asyncio
import contextlib
from asyncio import StreamReader, StreamWriter
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import InvalidURI

from rce.client.websocket import ConnectionClosed, Refused, open_websocket
from rce.errors import Unavailable

WAIT = 10.0
AWAY = "ws://robots.example:80/"  # no host of this machine, so that a proxy is used

Handle = Callable[[StreamReader, StreamWriter], Awaitable[None]]


@contextlib.asynccontextmanager
async def host(handle: Handle) -> AsyncIterator[str]:
    """Yield the authority of a server whose connections are handled so, and closed then."""

    async def handle_and_close(reader: StreamReader, writer: StreamWriter) -> None:
        with contextlib.closing(writer), contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            await handle(reader, writer)

    async with await asyncio.start_server(handle_and_close, "127.0.0.1", 0) as server:
        yield f"127.0.0.1:{server.sockets[0].getsockname()[1]}"


def answers(answer: bytes) -> Handle:
    async def handle(reader: StreamReader, writer: StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(answer)
        await writer.drain()

    return handle


async def hangs_up(reader: StreamReader, writer: StreamWriter) -> None:
    """Close the connection at once."""


async def is_silent(reader: StreamReader, writer: StreamWriter) -> None:
    await reader.read()


@pytest.mark.parametrize(
    ("handle", "seconds", "reason"),
    [
        pytest.param(hangs_up, WAIT, "closed during the handshake", id="hangs up"),
        pytest.param(answers(b""), WAIT, "closed during the handshake", id="hangs up after the request"),
        pytest.param(answers(b"hello\r\n\r\n"), WAIT, "cannot upgrade", id="other protocol"),
        pytest.param(is_silent, 0.05, "no answer", id="silent"),
    ],
)
async def test_server_that_does_not_answer_as_one_is_unavailable(handle: Handle, seconds: float, reason: str) -> None:
    async with host(handle) as where:
        with pytest.raises(Unavailable, match=reason):
            await open_websocket(f"ws://{where}/", seconds)


async def test_tls_that_is_not_answered_ends_in_time() -> None:
    async with host(is_silent) as where:
        with pytest.raises(Unavailable, match="no answer"):
            await open_websocket(f"wss://{where}/", 0.05)


async def test_connection_of_an_abandoned_handshake_is_closed() -> None:
    asked, closed = asyncio.Event(), asyncio.Event()

    async def handle(reader: StreamReader, writer: StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        asked.set()
        await reader.read()
        closed.set()

    async with host(handle) as where:
        task = asyncio.create_task(open_websocket(f"ws://{where}/", WAIT))
        await asyncio.wait_for(asked.wait(), WAIT)
        task.cancel()
        await asyncio.wait_for(closed.wait(), WAIT)


@pytest.mark.parametrize(
    ("answer", "reason", "standard"),
    [
        (b"HTTP/1.1 409 robot a is connected\r\n\r\n", "robot a is connected", False),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "Not Found", True),
        (b"HTTP/1.1 404 Not Found\r\nContent-Length: 11\r\n\r\nno such ann", "no such ann", False),
    ],
)
async def test_refusal_has_the_reason_of_the_body_or_of_the_status_line(
    answer: bytes, reason: str, standard: bool
) -> None:
    async with host(answers(answer)) as where:
        with pytest.raises(Refused) as refused:
            await open_websocket(f"ws://{where}/", WAIT)
    assert (str(refused.value), refused.value.standard) == (reason, standard)


async def test_uri_of_another_scheme_is_refused() -> None:
    with pytest.raises(InvalidURI):
        await open_websocket("http://127.0.0.1:1/", WAIT, direct=True)


async def test_proxy_is_used_unless_the_connection_is_direct(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[bytes] = []

    async def proxy(reader: StreamReader, writer: StreamWriter) -> None:
        lines.append(await reader.readline())
        await answers(b"HTTP/1.1 200 OK\r\n\r\n")(reader, writer)
        lines.append(await reader.readline())
        await answers(b"HTTP/1.1 503 the Master is away\r\n\r\n")(reader, writer)

    async with host(proxy) as where:
        monkeypatch.setenv("https_proxy", f"http://{where}/")
        monkeypatch.setenv("http_proxy", f"http://{where}/")
        with pytest.raises(Refused, match="the Master is away"):
            await open_websocket(f"{AWAY}x", WAIT)
        assert lines == [b"CONNECT robots.example:80 HTTP/1.1\r\n", b"GET /x HTTP/1.1\r\n"]
        with pytest.raises(Unavailable, match="closed during"):
            async with host(hangs_up) as other:
                await open_websocket(f"ws://{other}/", WAIT, direct=True)


async def test_refusal_by_a_proxy_has_its_status(monkeypatch: pytest.MonkeyPatch) -> None:
    async with host(answers(b"HTTP/1.1 407 Proxy Authentication Required\r\n\r\n")) as where:
        monkeypatch.setenv("https_proxy", f"http://{where}/")
        monkeypatch.setenv("http_proxy", f"http://{where}/")
        with pytest.raises(Unavailable, match="407"):
            await open_websocket(AWAY, WAIT)


@contextlib.asynccontextmanager
async def server(handle: Callable[[ServerConnection], Awaitable[None]]) -> AsyncIterator[str]:
    async with serve(handle, "127.0.0.1", 0, max_size=None, close_timeout=0.1) as running:
        yield f"ws://127.0.0.1:{next(iter(running.sockets)).getsockname()[1]}/"


async def echo(connection: ServerConnection) -> None:
    async for message in connection:
        await connection.send(message)


@pytest.mark.parametrize("compress", [False, True])
async def test_messages_of_all_sizes_arrive(compress: bool) -> None:
    async with server(echo) as uri:
        websocket = await open_websocket(uri, WAIT, compress=compress)
        for size in (0, 1, 125, 126, 65_535, 65_536, 1_000_000):
            for text in (True, False):
                await websocket.send(b"x" * size, text)
                assert await asyncio.wait_for(websocket.receive(), WAIT) == b"x" * size
        await websocket.close()


async def test_reason_of_the_server_is_known() -> None:
    async def end(connection: ServerConnection) -> None:
        await connection.close(1008, "too many of them")

    async with server(end) as uri:
        websocket = await open_websocket(uri, WAIT)
        with pytest.raises(ConnectionClosed):
            await asyncio.wait_for(websocket.receive(), WAIT)
        assert websocket.reason == "too many of them"


async def test_aborted_connection_ends_for_receiver_and_sender_even_if_the_server_reads_nothing() -> None:
    """As on a line that is dead: what was sent is not acknowledged."""

    async def read_nothing(connection: ServerConnection) -> None:
        connection.transport.pause_reading()
        await connection.wait_closed()

    async def send() -> None:
        begun.set()
        await websocket.send(bytes(64_000_000), False)  # more than all buffers have room for

    async with server(read_nothing) as uri:
        websocket = await open_websocket(uri, WAIT)
        begun = asyncio.Event()
        tasks = [asyncio.create_task(websocket.receive()), asyncio.create_task(send())]
        await asyncio.wait_for(begun.wait(), WAIT)
        websocket.abort()
        for task in tasks:
            with pytest.raises(ConnectionClosed):
                await asyncio.wait_for(task, WAIT)
        assert websocket.reason == "code 1006"
        websocket.abort()  # again, which changes nothing
