"""Endpoint descriptions, and listening sockets of aiohttp servers."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from aiohttp import web

from rce.errors import InvalidRequest, Unavailable
from rce.net import pending_logins
from rce.net.certificates import Authority
from rce.net.tls import CERTIFICATE, KEY
from rce.web import server
from rce.web.server import Endpoint, listen, parse_endpoint, serve_application, serve_handler
from tests.support.certificates import certify
from tests.support.dripping import drip

LOCAL = Endpoint("127.0.0.1", 0)


@pytest.mark.parametrize(
    ("description", "host", "port"),
    [
        ("tcp:9000", "0.0.0.0", 9000),
        ("tcp:0:interface=127.0.0.1", "127.0.0.1", 0),
        ("tcp:port=9000:interface=localhost", "localhost", 9000),
        ("tcp:interface=10.0.0.1:port=9000", "10.0.0.1", 9000),
        (r"tcp:9000:interface=\:\:", "::", 9000),
        ("tcp:9000:interface=", "0.0.0.0", 9000),
    ],
)
def test_tcp_description(description: str, host: str, port: int) -> None:
    endpoint = parse_endpoint(description)
    assert (endpoint.host, endpoint.port, endpoint.tls, endpoint.scheme) == (host, port, None, "http")


def test_backlog_is_taken_over() -> None:
    assert parse_endpoint("tcp:9000:backlog=5").backlog == 5


@pytest.mark.parametrize(
    ("description", "reason"),
    [
        ("", "begin with tcp: or ssl:"),
        ("9000", "begin with tcp: or ssl:"),
        ("unix:/run/rce", "begin with tcp: or ssl:"),
        ("systemd:domain=INET:index=0", "begin with tcp: or ssl:"),
        ("tcp", "port must be a number"),
        ("tcp:", "begin with tcp: or ssl:"),
        ("tcp:x", "port must be a number"),
        ("tcp:-1", "port must be a number"),
        ("tcp:65536", "port must be a number"),
        ("tcp:9000:127.0.0.1", "name=value"),
        ("tcp:9000:privateKey=x", "no option privateKey"),
        ("tcp:9000:backlog=x", "backlog must be a number"),
        ("ssl:9000", "certKey"),
        ("ssl:9000:privateKey=/nowhere", "certKey"),
        ("ssl:9000:certKey=x:sslmethod=TLSv1", "no option sslmethod"),
    ],
)
def test_wrong_description_is_refused_with_the_reason(description: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match="is no Twisted server endpoint such as tcp:9000") as raised:
        parse_endpoint(description)
    assert reason in str(raised.value)


def test_certificate_that_cannot_be_loaded_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match="nowhere"):
        parse_endpoint(f"ssl:9000:certKey={tmp_path}/nowhere")


@contextlib.asynccontextmanager
async def serving(handler: server.Handler, endpoint: Endpoint = LOCAL) -> AsyncIterator[int]:
    runner = serve_handler(handler)
    _, port = await listen(runner, endpoint)
    yield port
    await runner.cleanup()


async def hello(request: web.BaseRequest) -> web.Response:
    return web.Response(text="hello")


async def test_https(tmp_path: Path) -> None:
    keys = certify(tmp_path / "tls", Authority.make("tests"), ["localhost"])
    endpoint = parse_endpoint(f"ssl:0:interface=127.0.0.1:privateKey={keys / KEY}:certKey={keys / CERTIFICATE}")
    assert endpoint.scheme == "https"
    trust = ssl.create_default_context(cafile=str(keys / "ca.pem"))
    async with serving(hello, endpoint) as port:
        reader, writer = await asyncio.open_connection("localhost", port, ssl=trust)
        writer.write(b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
        assert (await asyncio.wait_for(reader.read(), 20)).endswith(b"\r\n\r\nhello")
        writer.close()


async def test_port_in_use_is_unavailable() -> None:
    async with serving(hello) as port:
        with pytest.raises(Unavailable, match=f"port {port} of 127.0.0.1 is in use"):
            await listen(serve_handler(hello), Endpoint("127.0.0.1", port))


async def test_connection_without_a_request_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(server.LIMITS, "keepalive_timeout", 0.1)
    async with serving(hello) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\nHost")
        assert await asyncio.wait_for(reader.read(), 20) == b""
        writer.close()


async def test_dripping_head_of_a_request_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(server.LIMITS, "keepalive_timeout", 0.2)
    async with serving(hello) as port:
        assert await drip(port) == b""


async def test_client_that_does_not_read_is_disconnected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "UNREAD_TIMEOUT", 0.1)
    ended = asyncio.Event()

    async def large(request: web.BaseRequest) -> web.StreamResponse:
        response = web.StreamResponse()
        await response.prepare(request)
        try:
            while True:
                await response.write(bytes(1_000_000))
        finally:
            ended.set()

    async with serving(large) as port:
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.transport.pause_reading()  # type: ignore[attr-defined]  # a ReadTransport too
        writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        await asyncio.wait_for(ended.wait(), 20)
        writer.transport.abort()


@pytest.mark.slow
async def test_client_that_reads_slowly_gets_the_whole_response(monkeypatch: pytest.MonkeyPatch) -> None:
    """It takes longer than the time for which a client may read nothing."""
    monkeypatch.setattr(server, "UNREAD_TIMEOUT", 3.0)
    began = time.monotonic()

    async def large(request: web.BaseRequest) -> web.Response:
        return web.Response(body=bytes(20_000_000))

    async with serving(large) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1000)
        writer.write(b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
        received = 0
        while piece := await asyncio.wait_for(reader.read(1_000_000), 20):
            received += len(piece)
            await asyncio.sleep(len(piece) / 5_000_000)
        assert received > 20_000_000
        assert time.monotonic() - began > 3.0
        writer.close()


async def test_connection_counts_for_its_address_until_login(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pending_logins, "MAX_PENDING", 2)
    monkeypatch.setattr(pending_logins, "network", lambda address: address)

    async def answer(request: web.BaseRequest) -> web.Response:
        if request.path == "/login":
            server.logged_in()
        return web.Response(text="done")

    async def ask(path: str) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writers.append(writer)
        writer.write(f"GET {path} HTTP/1.1\r\nHost: x\r\n\r\n".encode())
        try:
            return await asyncio.wait_for(reader.readuntil(b"done"), 20)
        except (asyncio.IncompleteReadError, ConnectionResetError):
            return b""

    writers: list[asyncio.StreamWriter] = []
    async with serving(answer) as port:
        for path in ("/login", "/login", "/login", "/", "/"):
            assert await ask(path)
        assert not await ask("/login")
        for writer in writers:
            writer.close()


class WaitingHandler:
    """Handler that waits until it is cancelled."""

    def __init__(self) -> None:
        self.started, self.cancelled = asyncio.Event(), asyncio.Event()

    async def __call__(self, request: web.BaseRequest) -> web.Response:
        self.started.set()
        try:
            await asyncio.Event().wait()
        finally:
            self.cancelled.set()
        return web.Response()


async def test_stopping_cancels_requests_and_closes_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "SHUTDOWN_TIMEOUT", 0.05)
    handler = WaitingHandler()
    async with serving(handler) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        await asyncio.wait_for(handler.started.wait(), 20)
    await asyncio.wait_for(handler.cancelled.wait(), 20)
    assert await asyncio.wait_for(reader.read(), 20) == b""
    writer.close()
    with pytest.raises(ConnectionRefusedError):
        await asyncio.open_connection("127.0.0.1", port)


async def test_request_is_cancelled_when_its_client_disconnects() -> None:
    handler = WaitingHandler()
    async with serving(handler) as port:
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(b"GET / HTTP/1.1\r\nHost: x\r\n\r\n")
        await asyncio.wait_for(handler.started.wait(), 20)
        writer.close()
        await asyncio.wait_for(handler.cancelled.wait(), 20)


async def test_client_that_disconnects_within_a_body_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    started, ended = asyncio.Event(), asyncio.Event()

    async def read(request: web.Request) -> web.Response:
        started.set()
        try:
            return web.Response(body=await request.read())
        finally:
            ended.set()

    application = web.Application()
    application.router.add_post("/", read)
    runner = serve_application(application)
    _, port = await listen(runner, LOCAL)
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 10\r\n\r\nabc")
    await asyncio.wait_for(started.wait(), 20)
    writer.close()
    await asyncio.wait_for(ended.wait(), 20)
    await runner.cleanup()
    assert not caplog.records
