"""Requests as they were sent, malformed ones too."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import make_mocked_request
from multidict import CIMultiDict

from rce.errors import Forbidden
from rce.web import requests
from rce.web.requests import check_same_site, declared_length, header, host_name, raw_path, raw_query, read_body
from rce.web.server import Endpoint, listen, serve_handler


def request(path: str = "/", **headers: str) -> web.BaseRequest:
    return make_mocked_request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})


def test_target_is_not_decoded() -> None:
    found = request("//a%20b/%ff?x=%2F&y")
    assert (raw_path(found), raw_query(found)) == ("//a%20b/%ff", "x=%2F&y")


@pytest.mark.parametrize(
    ("headers", "allowed"),
    [
        ({}, True),
        ({"Sec_Fetch_Site": "same-origin", "Origin": "https://behind.a.proxy"}, True),
        ({"Sec_Fetch_Site": "none"}, True),
        ({"Sec_Fetch_Site": "same-site"}, False),
        ({"Sec_Fetch_Site": "cross-site", "Origin": "http://cloud:9000"}, False),
        ({"Origin": "http://cloud:9000"}, True),
        ({"Origin": "https://CLOUD:9000"}, True),
        ({"Origin": "http://cloud:9001"}, False),
        ({"Origin": "http://evil"}, False),
        ({"Origin": "null"}, False),
        ({"Origin": ""}, False),
    ],
)
def test_pages_of_other_sites_only_read(headers: dict[str, str], allowed: bool) -> None:
    check_same_site(request(Host="cloud:9000", **headers))
    change = request(Host="cloud:9000", **headers).clone(method="POST")
    if allowed:
        check_same_site(change)
    else:
        with pytest.raises(Forbidden):
            check_same_site(change)


@pytest.mark.parametrize(
    ("host", "name"),
    [
        ("cloud.example:9000", "cloud.example"),
        ("cloud.example", "cloud.example"),
        ("[::1]:9000", "::1"),
        ("[2001:db8::2]", "2001:db8::2"),
        ('e"vil\\', 'e"vil\\'),
        ("café", "caf?"),
    ],
)
def test_host_name(host: str, name: str) -> None:
    assert host_name(request(Host=host)) == name


def test_header_that_is_not_utf8_is_replaced() -> None:
    received: Any = SimpleNamespace(headers=CIMultiDict({"Authorization": "Basic \udcff"}))  # as aiohttp decodes it
    assert header(received, "Authorization") == "Basic �"
    assert header(request(), "Authorization") is None


def test_length_of_a_body() -> None:
    assert declared_length(request()) == 0
    assert declared_length(request(Content_Length="7")) == 7
    assert declared_length(request(Transfer_Encoding="chunked")) is None


@pytest.fixture
async def port() -> AsyncIterator[int]:
    """Port of a server that returns bodies."""

    async def echo(request: web.BaseRequest) -> web.Response:
        return web.Response(body=await read_body(request))

    runner = serve_handler(echo)
    _, port = await listen(runner, Endpoint("127.0.0.1", 0))
    yield port
    await runner.cleanup()


async def send(port: int, headers: str, body: bytes = b"", drip: float = 0) -> str:
    """Return the answer to a POST; with `drip` the last byte of the body is repeated after so many seconds each."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"POST / HTTP/1.1\r\nHost: x\r\n{headers}\r\n\r\n".encode() + body)

    async def repeat() -> None:
        while drip:
            await asyncio.sleep(drip)
            writer.write(body[-1:])

    dripping = asyncio.create_task(repeat())
    try:
        return (await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 20)).decode()
    finally:
        dripping.cancel()
        writer.close()


async def test_silent_and_dripping_bodies_are_refused_in_time(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "BODY_TIMEOUT", 0.2)
    assert "408 Request Timeout" in await send(port, "Content-Length: 10")
    assert "408 Request Timeout" in await send(port, "Content-Length: 100000", b"x", drip=0.02)


async def test_body_at_a_sane_rate_has_the_time_that_it_needs(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "BODY_TIMEOUT", 1.0)
    monkeypatch.setattr(requests, "MIN_RATE", 1)
    assert "200 OK" in await send(port, "Content-Length: 30", b"x", drip=0.05)


@pytest.mark.parametrize("encoding", ["gzip", "deflate", "br", "zstd", "nonsense", "gzip, gzip"])
async def test_compressed_body_is_refused(port: int, encoding: str) -> None:
    answer = await send(port, f"Content-Encoding: {encoding}\r\nContent-Length: 3", b"abc")
    assert "415 Unsupported Media Type" in answer
    assert "Accept-Encoding: identity" in answer


async def test_malformed_body_is_refused(port: int) -> None:
    assert " 400 " in await send(port, "Transfer-Encoding: chunked", b"zz\r\nabc\r\n")


async def test_large_body_is_refused(port: int) -> None:
    assert "413 " in await send(port, "Content-Length: 2000000", bytes(2_000_000))


async def test_identity_is_no_compression(port: int) -> None:
    assert "200 OK" in await send(port, "Content-Encoding: Identity\r\nContent-Length: 3", b"abc")
