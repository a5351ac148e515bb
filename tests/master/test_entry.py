"""The HTTP entry as a robot sees it: the original's status codes, content types and answers."""

from __future__ import annotations

import asyncio
import http.client
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import NamedTuple

import pytest
from fleet import Fleet
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase
from twisted.web.server import Site

from master.entry import Entry
from rce.messages import CURRENT_VERSION, MINIMAL_VERSION

GOOD = f"/?userID=ann&version={CURRENT_VERSION}"
PLAIN = "text/plain; charset=utf-8"


class Answer(NamedTuple):
    status: int
    kind: str | None
    body: bytes


Ask = Callable[..., Awaitable[Answer]]


@pytest.fixture
def fleet() -> Fleet:
    fleet = Fleet()
    fleet.join("west", "robot", url="ws://:9010/")
    return fleet


@pytest.fixture
async def ask(reactor: ReactorBase, fleet: Fleet) -> AsyncIterator[Ask]:
    loop = asyncio.get_running_loop()
    endpoint = endpoints.serverFromString(reactor, "tcp:0:interface=127.0.0.1")
    port = await endpoint.listen(Site(Entry(fleet.state))).asFuture(loop)
    number = port.getHost().port

    def request(path: str, method: str = "GET", **headers: str) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", number, timeout=20)
        connection.request(method, path, headers={"Connection": "close", **headers})
        response = connection.getresponse()
        answer = Answer(response.status, response.getheader("content-type"), response.read())
        connection.close()
        return answer

    async def ask(path: str, method: str = "GET", **headers: str) -> Answer:
        return await asyncio.to_thread(request, path, method, **headers)

    yield ask
    await port.stopListening().asFuture(loop)


async def test_the_address_of_a_robot_endpoint(ask: Ask) -> None:
    status, kind, body = await ask(GOOD, Host="cloud.example:9000")
    assert (status, kind) == (200, "application/json; charset=utf-8")
    assert json.loads(body) == {"url": "ws://cloud.example:9010/"}


@pytest.mark.parametrize("path", ["/robot", "/a/b/c"])
async def test_any_path_will_do(ask: Ask, path: str) -> None:
    assert (await ask(path + GOOD[1:])).status == 200


@pytest.mark.parametrize("version", [MINIMAL_VERSION, "20130901"])
async def test_an_older_client_is_told_the_current_version(ask: Ask, version: str) -> None:
    _, _, body = await ask(f"/?userID=anybody&version={version}", Host="c")
    assert json.loads(body) == {"url": "ws://c:9010/", "current": CURRENT_VERSION}


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
async def test_refusals(ask: Ask, query: str, status: int, named: str) -> None:
    answer = await ask("/?" + query)
    assert (answer.status, answer.kind) == (status, PLAIN)
    assert named in answer.body.decode()
    assert answer.body.count(b"\n") == 1


async def test_no_robot_endpoint(ask: Ask, fleet: Fleet) -> None:
    fleet.state.joined.clear()
    status, kind, body = await ask(GOOD)
    assert (status, kind) == (503, PLAIN)
    assert b"Robot endpoint" in body


async def test_head_has_no_body_and_post_is_not_allowed(ask: Ask) -> None:
    assert await ask(GOOD, "HEAD") == (200, "application/json; charset=utf-8", b"")
    assert (await ask(GOOD, "POST")).status == 405


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("[::1]:9000", "ws://[::1]:9010/"),
        ("[2001:db8::2]", "ws://[2001:db8::2]:9010/"),
        ("203.0.113.7", "ws://203.0.113.7:9010/"),
        ('e"vil\\', 'ws://e"vil\\:9010/'),
    ],
)
async def test_without_a_public_address_the_host_is_that_of_the_request(ask: Ask, host: str, url: str) -> None:
    assert json.loads((await ask(GOOD, Host=host)).body)["url"] == url


async def test_a_public_address_is_given_as_it_is(ask: Ask, fleet: Fleet) -> None:
    fleet.join("west", "robot", url="wss://robots.example/ws/")
    assert json.loads((await ask(GOOD)).body)["url"] == "wss://robots.example/ws/"


async def test_the_endpoint_with_the_fewest_robots(ask: Ask, fleet: Fleet) -> None:
    fleet.join("east", "robot", url="ws://east:1/")
    urls = []
    for number in range(4):
        url = json.loads((await ask(GOOD, Host="west")).body)["url"]
        urls.append(url)
        fleet.robot(f"ann/r{number}", "east" if "east" in url else "west")
    assert urls == ["ws://east:1/", "ws://west:9010/"] * 2
