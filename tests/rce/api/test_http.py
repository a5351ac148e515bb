"""Requests to a platform's entry and the errors of its responses."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
from aiohttp import web

from rce.api import http
from rce.api.http import EntryClient, Problem, basic, bearer, error_of_response, is_local
from rce.errors import InvalidRequest, NotFound, RceError, Unavailable

PROBLEM = b'{"title":"Not Found","status":404,"detail":"no such robot","code":"not_found","fields":{"robot":"a"}}'


@pytest.fixture
async def url() -> AsyncIterator[str]:
    """A server that echoes its requests, with a redirect and a problem."""

    async def echo(request: web.Request) -> web.Response:
        headers = {name: request.headers.get(name, "") for name in ("Authorization", "X-Extra")}
        return web.json_response({"path": request.path, "body": await request.text(), **headers})

    async def redirect(request: web.Request) -> web.Response:
        raise web.HTTPTemporaryRedirect("/elsewhere")

    async def problem(request: web.Request) -> web.Response:
        return web.Response(status=404, body=PROBLEM, content_type="application/problem+json")

    app = web.Application()
    app.add_routes([web.get("/redirect", redirect), web.get("/problem", problem), web.route("*", "/{path:.*}", echo)])
    runner = web.AppRunner(app)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    yield f"http://127.0.0.1:{runner.addresses[0][1]}"
    await runner.cleanup()


async def test_request_has_path_headers_and_json_body(url: str) -> None:
    client = EntryClient(url, bearer("token"))
    body = Problem("t", 1, "d", "c")
    response = await asyncio.to_thread(client.json, "POST", "api/v1/x", body)
    assert b'"path": "/api/v1/x"' in response
    assert b'"Authorization": "Bearer token"' in response
    assert rb"\"title\":\"t\"" in response


def test_basic_credentials_are_encoded_as_utf8() -> None:
    header = basic("ann", "pässword")["Authorization"]
    assert base64.b64decode(header.removeprefix("Basic ")).decode() == "ann:pässword"


async def test_problem_is_raised_as_its_error(url: str) -> None:
    client = EntryClient(url, {})
    with pytest.raises(NotFound, match="no such robot") as caught:
        await asyncio.to_thread(client.json, "GET", "problem")
    assert caught.value.info.fields == {"robot": "a"}


async def test_redirect_is_not_followed(url: str) -> None:
    with pytest.raises(Unavailable, match="HTTP status 307"):
        await asyncio.to_thread(EntryClient(url, {}).json, "GET", "redirect")


async def test_unreachable_entry_is_unavailable() -> None:
    with pytest.raises(Unavailable, match=r"cannot reach http://127\.0\.0\.1:1/x: connection refused\. Does the"):
        await asyncio.to_thread(EntryClient("http://127.0.0.1:1/", {}).json, "GET", "x")


def test_url_must_be_http() -> None:
    with pytest.raises(InvalidRequest, match="http://"):
        EntryClient("ftp://x/", {})


@pytest.mark.parametrize(
    ("media_type", "body", "reason"),
    [
        ("application/problem+json", b"{", "malformed"),
        ("text/html", b"<h1>Bad Gateway</h1>", "Bad Gateway"),
        ("text/plain", b"", "no reason given"),
    ],
)
def test_response_without_problem_is_unavailable(media_type: str, body: bytes, reason: str) -> None:
    error = error_of_response(502, media_type, body)
    assert isinstance(error, Unavailable)
    assert reason in str(error)


def test_unknown_code_is_a_plain_error() -> None:
    error = error_of_response(400, "application/problem+json", PROBLEM.replace(b"not_found", b"from_the_future"))
    assert type(error) is RceError
    assert error.info.code == "from_the_future"


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("http://localhost:80/", True),
        ("http://127.8.0.1/", True),
        ("http://[::1]/", True),
        ("http://10.0.0.1/", False),
        ("http://example.org/", False),
    ],
)
def test_loopback_urls(url: str, expected: bool) -> None:
    assert is_local(url) is expected


# --- several Masters --------------------------------------------------------------------------------------------------

STANDBY = (
    b'{"title":"Unavailable","status":503,"detail":"a standby","code":"unavailable","fields":{"leader":"http://x/"}}'
)


class Masters:
    """Servers of which one leads: the others refuse requests."""

    def __init__(self) -> None:
        self.leader = 0
        self.asked: list[int] = []
        self.urls: list[str] = []

    def handler(self, number: int) -> Callable[[web.Request], Awaitable[web.Response]]:
        async def handle(request: web.Request) -> web.Response:
            self.asked.append(number)
            if number != self.leader:
                return web.Response(status=503, body=STANDBY, content_type="application/problem+json")
            return web.json_response(await request.text())

        return handle


@pytest.fixture
async def masters() -> AsyncIterator[Masters]:
    masters, runners = Masters(), []
    for number in range(2):
        runner = web.ServerRunner(web.Server(masters.handler(number)))  # type: ignore[arg-type]
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        runners.append(runner)
        masters.urls.append(f"http://127.0.0.1:{runner.addresses[0][1]}")
    yield masters
    for runner in runners:
        await runner.cleanup()


async def test_request_goes_to_the_master_that_leads(masters: Masters) -> None:
    client = EntryClient(",".join(["http://127.0.0.1:1", *masters.urls]), {})
    for masters.leader in (1, 1, 0):
        assert await asyncio.to_thread(client.json, "POST", "x", Problem("t", 1, "d", "c"))
        assert client.url == masters.urls[masters.leader] + "/"
    assert masters.asked == [0, 1, 1, 1, 0]


async def test_request_waits_for_a_take_over(masters: Masters, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http, "PAUSE", (0.0, 0.01))
    masters.leader = 2
    client = EntryClient(",".join(masters.urls), {})
    asking = asyncio.create_task(asyncio.to_thread(client.json, "GET", "x"))
    while len(masters.asked) < 4:  # noqa: ASYNC110  # the servers note it
        await asyncio.sleep(0.001)
    masters.leader = 1
    await asking
    monkeypatch.setattr(http, "TAKE_OVER", 0.0)
    masters.leader = 2
    with pytest.raises(Unavailable, match="a standby"):
        await asyncio.to_thread(client.json, "GET", "x")
