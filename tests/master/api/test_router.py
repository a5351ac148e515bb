"""Requests find their handlers, and errors are problem+json."""

from __future__ import annotations

import errno
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from aiohttp import web
from msgspec import Struct
from twisted.logger import LogEvent

from master.access.audit import Audit, AuditFilter
from master.access.users import Users
from master.api.request import Answer, Call
from master.api.router import PREFIX, Api, Route
from master.storage.store import Store
from rce.api import http as client
from rce.errors import Lost
from tests.support.master.calls import make_call
from tests.support.master.served import Served


class Greeting(Struct):
    """A body."""

    text: str


class Routes:
    """An API whose handlers record their calls and answer with the name of their route."""

    def __init__(self, store: Store) -> None:
        self.audit = Audit(store)
        self.api = Api(Users(store), self.audit)
        self.calls: list[Call] = []

    def add(self, method: str, path: str, answer: Answer | Exception | None = None, **options: Any) -> None:
        async def handler(call: Call) -> Answer:
            self.calls.append(call)
            if isinstance(answer, Exception):
                raise answer
            return answer or Answer([f"{method} {path}"])

        self.api.add(Route(method, path, handler, **{"public": True, **options}))

    async def ask(
        self, method: str, path: str, content: bytes = b"", headers: dict[str, str] | None = None
    ) -> web.Response:
        response = await self.api.handle(make_call(None, method, path, headers=headers).request, content, None)
        assert isinstance(response, web.Response)
        return response


@pytest.fixture
def routes(store: Store) -> Routes:
    return Routes(store)


def contents(response: web.Response) -> Any:
    assert isinstance(response.body, bytes)
    return msgspec.json.decode(response.body)


async def test_variables_of_the_path_are_decoded(routes: Routes) -> None:
    routes.add("GET", "/things/{thing}/parts/{part}")
    await routes.ask("GET", f"{PREFIX}/things/a%2Fb/parts/%C3%BC")
    assert routes.calls[-1].path == {"thing": "a/b", "part": "ü"}


@pytest.mark.parametrize("path", ["/things/%ff", "/things/", "/things", "/things/a/", "/things/a/b", "", "/Things/a"])
async def test_other_paths_are_not_found(routes: Routes, path: str) -> None:
    routes.add("GET", "/things/{thing}")
    response = await routes.ask("GET", PREFIX + path)
    assert (response.status, contents(response)["code"]) == (404, "not_found")
    assert (await routes.ask("GET", "/things/a")).status == 404
    assert not routes.calls


async def test_path_without_variables_takes_precedence(routes: Routes) -> None:
    routes.add("GET", "/things/{thing}")
    routes.add("GET", "/things/all")
    assert contents(await routes.ask("GET", f"{PREFIX}/things/all")) == ["GET /things/all"]
    assert contents(await routes.ask("GET", f"{PREFIX}/things/one")) == ["GET /things/{thing}"]


async def test_other_methods_are_refused_with_the_allowed_ones(routes: Routes) -> None:
    routes.add("GET", "/things")
    routes.add("POST", "/things")
    routes.add("PUT", "/uploads")
    response = await routes.ask("PATCH", f"{PREFIX}/things")
    assert (response.status, response.headers["Allow"]) == (405, "GET, HEAD, POST")
    assert (await routes.ask("GET", f"{PREFIX}/uploads")).headers["Allow"] == "PUT"
    assert (await routes.ask("HEAD", f"{PREFIX}/things")).status == 200


async def test_routes_outside_the_prefix_are_not_described(routes: Routes) -> None:
    async def handler(call: Call) -> Answer:
        return Answer(["alive"])

    routes.api.add_outside_prefix(Route("GET", "/healthz", handler, public=True))
    assert contents(await routes.ask("GET", "/healthz")) == ["alive"]
    assert (await routes.ask("GET", f"{PREFIX}/healthz")).status == 404
    assert routes.api.routes == []


async def test_mounted_handler_gets_the_request_as_it_is(routes: Routes) -> None:
    async def handle(request: web.BaseRequest) -> web.StreamResponse:
        return web.Response(status=418, text=request.method)

    routes.api.mount("/live", handle)
    response = await routes.ask("BREW", f"{PREFIX}/live?x=1")
    assert (response.status, response.text) == (418, "BREW")


# --- queries and bodies -----------------------------------------------------------------------------------------------


async def test_parameters_of_the_query_are_decoded(routes: Routes) -> None:
    routes.add("GET", "/things")
    await routes.ask("GET", f"{PREFIX}/things?a=1%262&b=&c=%C3%BC&d")
    assert routes.calls[-1].parameters == {"a": "1&2", "b": "", "c": "ü", "d": ""}


@pytest.mark.parametrize(("query", "field"), [("a=1&a=2", "a"), ("a=%ff", "query"), ("%ff=1", "query")])
async def test_ambiguous_query_is_refused(routes: Routes, query: str, field: str) -> None:
    routes.add("GET", "/things")
    response = await routes.ask("GET", f"{PREFIX}/things?{query}")
    assert (response.status, contents(response)["field"]) == (400, field)


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        ("application/json", 200),
        ("Application/JSON; charset=utf-8", 200),
        ("", 415),
        ("text/plain", 415),
        ("application/x-www-form-urlencoded", 415),
        ("multipart/form-data; boundary=x", 415),
    ],
)
async def test_forms_are_refused(routes: Routes, kind: str, status: int) -> None:
    routes.add("POST", "/things", body=Greeting)
    routes.add("POST", "/others")
    headers = {"Content-Type": kind} if kind else {}
    assert (await routes.ask("POST", f"{PREFIX}/things", b"{}", headers)).status == status
    assert (await routes.ask("POST", f"{PREFIX}/others", b"{}", headers)).status == 200  # takes no body


async def test_page_of_another_site_changes_nothing(routes: Routes) -> None:
    for method in ("GET", "POST", "PUT", "PATCH", "DELETE"):
        routes.add(method, "/things")
        answer = await routes.ask(method, f"{PREFIX}/things", b"", {"Sec-Fetch-Site": "cross-site"})
        assert answer.status == (200 if method == "GET" else 403)


# --- answers ----------------------------------------------------------------------------------------------------------


async def test_answers_are_sent_by_their_types(routes: Routes, tmp_path: Path) -> None:
    routes.add("GET", "/struct", Answer(Greeting("hi"), 201, {"location": "/there"}))
    routes.add("GET", "/bytes", Answer(b"a 1\n", headers={"content-type": "text/plain"}))
    routes.add("GET", "/nothing", Answer(status=204))
    routes.add("GET", "/raw", Answer(msgspec.Raw(b"[1]")))
    struct, text, nothing, raw = [
        await routes.ask("GET", PREFIX + path) for path in ("/struct", "/bytes", "/nothing", "/raw")
    ]
    assert (struct.status, struct.body, struct.headers["location"]) == (201, b'{"text":"hi"}', "/there")
    assert struct.content_type == "application/json"
    assert (text.body, text.content_type) == (b"a 1\n", "text/plain")
    assert (nothing.status, nothing.body) == (204, None)
    assert raw.body == b"[1]"
    routes.add("GET", "/file", Answer(tmp_path / "archive"))
    file = await routes.api.handle(make_call(None, "GET", f"{PREFIX}/file").request, b"", None)
    assert isinstance(file, web.FileResponse)
    assert file.content_type == "application/octet-stream"


async def test_request_id_is_in_the_answer(routes: Routes) -> None:
    routes.add("GET", "/things")
    assert (await routes.ask("GET", f"{PREFIX}/things", headers={"X-Request-Id": "r1"})).headers["X-Request-Id"] == "r1"
    assert (await routes.ask("GET", f"{PREFIX}/none", headers={"X-Request-Id": "r2"})).headers["X-Request-Id"] == "r2"
    assert (await routes.ask("GET", f"{PREFIX}/things")).headers["X-Request-Id"]


async def test_error_of_a_handler_is_a_problem(routes: Routes) -> None:
    routes.add("GET", "/things", Lost("it went"))
    response = await routes.ask("GET", f"{PREFIX}/things")
    assert (response.status, response.content_type) == (503, "application/problem+json")
    assert (contents(response)["code"], contents(response)["detail"]) == ("lost", "it went")


async def test_full_disk_is_told(routes: Routes, failures: list[LogEvent]) -> None:
    routes.add("GET", "/things", OSError(errno.ENOSPC, "no space"))
    response = await routes.ask("GET", f"{PREFIX}/things")
    assert (response.status, contents(response)["code"]) == (503, "unavailable")
    assert contents(response)["detail"].startswith("disk full")
    assert failures == []


async def test_defect_is_logged_and_not_told(routes: Routes, failures: list[LogEvent]) -> None:
    routes.add("GET", "/things", ZeroDivisionError("the secret is 7"))
    response = await routes.ask("GET", f"{PREFIX}/things")
    assert (response.status, contents(response)["code"]) == (500, "internal")
    assert "secret" not in str(contents(response))
    (failure,) = failures
    assert failure["path"] == f"{PREFIX}/things"


async def test_disconnected_client_gets_no_answer(routes: Routes, failures: list[LogEvent]) -> None:
    routes.add("GET", "/things", ConnectionResetError())
    with pytest.raises(ConnectionError):
        await routes.ask("GET", f"{PREFIX}/things")
    assert not failures


# --- credentials and audit --------------------------------------------------------------------------------------------


async def test_routes_need_credentials_unless_they_are_public(routes: Routes, users: Users) -> None:
    routes.add("GET", "/things", public=False)
    assert (await routes.ask("GET", f"{PREFIX}/things")).status == 401
    assert not routes.calls
    assert (await routes.ask("GET", f"{PREFIX}/things", headers=client.basic("ann", "secret"))).status == 200
    (call,) = routes.calls
    assert (call.user, call.principal is not None) == ("ann", True)


async def test_changes_are_recorded(routes: Routes, users: Users) -> None:
    routes.add("GET", "/things", public=False)
    routes.add("POST", "/things", public=False)
    for method in ("GET", "POST"):
        await routes.ask(method, f"{PREFIX}/things", headers=client.basic("ann", "secret"))
    recorded = await routes.audit.find(AuditFilter(), None, 10)
    assert [(each.user, each.action, each.result) for each in recorded] == [("ann", f"POST {PREFIX}/things", "ok")]


async def test_repeated_post_with_a_key_is_handled_once(routes: Routes, users: Users) -> None:
    routes.add("POST", "/things", public=False)
    routes.add("PUT", "/things", public=False)
    headers = client.basic("ann", "secret") | {"Idempotency-Key": "k"}
    for method in ("POST", "POST", "PUT", "PUT"):
        assert (await routes.ask(method, f"{PREFIX}/things", headers=headers)).status == 200
    assert [call.method for call in routes.calls] == ["POST", "PUT", "PUT"]


async def test_stopping_ends_what_goes_on(routes: Routes) -> None:
    stopped = []

    def stop(name: str) -> Callable[[], Awaitable[None]]:
        async def end() -> None:
            stopped.append(name)

        return end

    routes.api.on_stop += [stop("streams"), stop("live")]
    await routes.api.stop()
    assert stopped == ["streams", "live"]


async def test_head_has_no_body(served: Served) -> None:
    await served.robot("ann", "r1")
    head = await served.ask("HEAD", "/robots/r1")
    assert (head.status, head.body) == (200, None)
