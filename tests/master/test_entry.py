"""HTTP entry as a robot sees it: status codes, content types and answers of the original."""

from __future__ import annotations

import asyncio
import json

import pytest

from rce.protocol.messages import CURRENT_VERSION, MINIMAL_VERSION
from tests.support.master.entry import Ask
from tests.support.master.fleet import Fleet

GOOD = f"/?userID=ann&version={CURRENT_VERSION}"
PLAIN = "text/plain; charset=utf-8"


@pytest.fixture
def fleet() -> Fleet:
    fleet = Fleet()
    fleet.join("west", "robot", url="ws://:9010/")
    return fleet


async def test_answer_is_the_address_of_a_robot_endpoint(ask: Ask) -> None:
    status, kind, body, *_ = await ask(GOOD, Host="cloud.example:9000")
    assert (status, kind) == (200, "application/json; charset=utf-8")
    assert json.loads(body) == {"url": "ws://cloud.example:9010/"}


@pytest.mark.parametrize("path", ["/robot", "/a/b/c"])
async def test_any_path_is_answered_as_the_root(ask: Ask, path: str) -> None:
    assert (await ask(path + GOOD[1:])).status == 200


@pytest.mark.parametrize("version", [MINIMAL_VERSION, "20130901"])
async def test_older_client_is_told_the_current_version(ask: Ask, version: str) -> None:
    answer = await ask(f"/?userID=anybody&version={version}", Host="c")
    assert json.loads(answer.body) == {"url": "ws://c:9010/", "current": CURRENT_VERSION}


@pytest.mark.parametrize(
    ("query", "status", "named"),
    [
        ("userID=ann", 400, "version"),
        ("", 400, "version"),
        (f"userID=ann&version={CURRENT_VERSION}&version={CURRENT_VERSION}", 400, "version"),
        ("userID=ann&version=20130414", 410, MINIMAL_VERSION),
        ("userID=ann&version=", 410, MINIMAL_VERSION),
        ("version=1", 410, MINIMAL_VERSION),  # the version comes before the user
        ("userID=ann&version=20130903", 501, CURRENT_VERSION),
        ("userID=ann&version=3", 501, CURRENT_VERSION),  # compared as text
        (f"version={CURRENT_VERSION}", 400, "userID"),
        (f"version={CURRENT_VERSION}&userID=a&userID=a", 400, "userID"),
        ("userID=ann&version=%ff", 400, "version"),
        (f"version={CURRENT_VERSION}&userID=%ff", 400, "userID"),
    ],
)
async def test_wrong_parameters_are_refused(ask: Ask, query: str, status: int, named: str) -> None:
    answer = await ask("/?" + query)
    assert (answer.status, answer.kind) == (status, PLAIN)
    assert named in answer.body.decode()
    assert answer.body.count(b"\n") == 1


async def test_without_a_robot_endpoint_the_entry_is_unavailable(ask: Ask, fleet: Fleet) -> None:
    fleet.state.joined.clear()
    status, kind, body, *_ = await ask(GOOD)
    assert (status, kind) == (503, PLAIN)
    assert b"Robot endpoint" in body


async def test_head_has_no_body_and_post_is_not_allowed(ask: Ask) -> None:
    assert (await ask(GOOD, "HEAD"))[:3] == (200, "application/json; charset=utf-8", b"")
    for method in ("POST", "PUT", "DELETE", "PATCH"):
        assert (await ask(GOOD, method)).status == 405


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("[::1]:9000", "ws://[::1]:9010/"),
        ("[2001:db8::2]", "ws://[2001:db8::2]:9010/"),
        ("203.0.113.7", "ws://203.0.113.7:9010/"),
        ('e"vil\\', 'ws://e"vil\\:9010/'),
    ],
)
async def test_endpoint_without_a_host_is_on_the_host_of_the_request(ask: Ask, host: str, url: str) -> None:
    assert json.loads((await ask(GOOD, Host=host)).body)["url"] == url


async def test_public_address_of_an_endpoint_is_not_changed(ask: Ask, fleet: Fleet) -> None:
    fleet.join("west", "robot", url="wss://robots.example/ws/")
    assert json.loads((await ask(GOOD)).body)["url"] == "wss://robots.example/ws/"


async def test_endpoint_with_the_fewest_robots_is_chosen(ask: Ask, fleet: Fleet) -> None:
    fleet.join("east", "robot", url="ws://east:1/")
    urls = []
    for number in range(4):
        url = json.loads((await ask(GOOD, Host="west")).body)["url"]
        urls.append(url)
        fleet.robot(f"ann/r{number}", "east" if "east" in url else "west")
    assert urls == ["ws://east:1/", "ws://west:9010/"] * 2


async def test_body_that_is_not_announced_is_read_before_the_answer(port: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(b"POST / HTTP/1.1\r\nHost: c\r\nExpect: 100-continue\r\nContent-Length: 2\r\n\r\n")
    assert await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 20) == b"HTTP/1.1 100 Continue\r\n\r\n"
    writer.write(b"{}")
    assert (await asyncio.wait_for(reader.readline(), 20)).split()[1] == b"405"
    writer.close()


@pytest.mark.parametrize(
    "request_line",
    [b"nonsense", b"GET", b"GET / HTTP/3.7", b"GET nowhere HTTP/1.1", b"GET /" + b"x" * 20_000 + b" HTTP/1.1"],
)
async def test_malformed_request_line_is_a_bad_request_and_logs_nothing(
    port: int, request_line: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request_line + b"\r\nHost: c\r\nAuthorization: Bearer secret\r\n\r\n")
    assert (await asyncio.wait_for(reader.readline(), 20)).split()[1] == b"400"
    writer.close()
    assert not caplog.records


@pytest.mark.parametrize("length", [16_000, 20_000])
async def test_long_header_is_a_bad_request(port: int, length: int) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(f"GET {GOOD} HTTP/1.1\r\nHost: c\r\nX: {'x' * length}\r\n\r\n".encode())
    status = (await asyncio.wait_for(reader.readline(), 20)).split()[1]
    assert status == (b"200" if length < 16_384 else b"400")
    writer.close()


async def test_pages_of_any_origin_may_read_the_answer(ask: Ask) -> None:
    answer = await ask(GOOD, Origin="https://elsewhere.example")
    assert answer.origins == "*"


async def test_browser_is_shown_the_way_to_the_dashboard(ask: Ask) -> None:
    answer = await ask("/nothing", Accept="text/html,application/xhtml+xml")
    assert (answer.status, answer.kind) == (404, PLAIN)
    assert "the dashboard is at /ui/" in str(answer.body)
    assert (await ask("/nothing" + GOOD[1:], Accept="text/html")).status == 200, "with parameters it is a robot"
