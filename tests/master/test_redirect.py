"""Redirects to services over HTTP, and the addresses of processes."""

from __future__ import annotations

import asyncio

import pytest

from master.redirect import absolute_url
from tests.support.master.entry import Ask
from tests.support.master.fleet import Fleet


@pytest.fixture
def fleet() -> Fleet:
    fleet = Fleet()
    fleet.join("west", "robot", url="ws://:9010/")
    fleet.join("map-service", "service", url="http://:9020/")
    return fleet


@pytest.mark.parametrize(
    ("url", "host", "absolute"),
    [
        ("ws://:9010/", "cloud", "ws://cloud:9010/"),
        ("ws://:9010/", "::1", "ws://[::1]:9010/"),
        ("https://maps.example/base/", "cloud", "https://maps.example/base/"),
        ("http://[::1]:9020/", "cloud", "http://[::1]:9020/"),
    ],
)
def test_address_without_a_host_is_on_the_host_of_the_request(url: str, host: str, absolute: str) -> None:
    assert absolute_url(url, host) == absolute


@pytest.mark.parametrize("method", ["GET", "HEAD", "POST", "PATCH", "DELETE", "OPTIONS"])
async def test_request_for_a_service_is_redirected(ask: Ask, method: str) -> None:
    answer = await ask("/map-service/uploads/1?key=rce_1", method, Host="cloud:9000")
    assert (answer.status, answer.location) == (307, "http://cloud:9020/map-service/uploads/1?key=rce_1")
    assert (await ask("/map-service", Host="[::1]:9000")).location == "http://[::1]:9020/map-service"


async def test_public_address_of_a_service_is_not_changed(ask: Ask, fleet: Fleet) -> None:
    fleet.join("map-service", "service", url="https://maps.example/")
    assert (await ask("//map-service/a%20b", Host="c")).location == "https://maps.example/map-service/a%20b"


async def test_service_that_is_away_is_unavailable(ask: Ask, fleet: Fleet) -> None:
    fleet.state.joined.discard("map-service")
    answer = await ask("/map-service/jobs")
    assert (answer.status, answer.location) == (503, None)
    assert b"map-service is away" in answer.body


async def test_only_services_are_redirected(ask: Ask) -> None:
    for path in ("/west/", "/other-service/", "/map-services/", "/"):
        assert (await ask(path)).status == 400, path


@pytest.mark.parametrize("framing", ["Content-Length: 4000000000", "Transfer-Encoding: chunked"])
@pytest.mark.parametrize(
    ("path", "status", "location"),
    [("/map-service/uploads", b"307", b"http://c:9020/map-service/uploads"), ("/", b"413", b"")],
)
async def test_large_body_is_refused_before_it_is_sent(
    port: int, path: str, framing: str, status: bytes, location: bytes
) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"POST {path} HTTP/1.1\r\nHost: c:9000\r\nExpect: 100-continue\r\n{framing}\r\n\r\n".encode())
    answer = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 20)
    assert answer.split()[1] == status
    assert location in answer
    assert b"100 Continue" not in answer
    writer.close()
