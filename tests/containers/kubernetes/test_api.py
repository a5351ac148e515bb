"""Access to an API server, which is a small HTTP server here."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from aiohttp import web

pytest.importorskip("kubernetes_asyncio", reason="needs kubernetes_asyncio: pip install '.[kubernetes]'")

from containers.kubernetes.api import GONE, Api, Event, Refused
from rce.errors import NotFound, Unavailable

CONFIG = """
apiVersion: v1
kind: Config
clusters: [{{name: c, cluster: {{server: "http://127.0.0.1:{port}"}}}}]
users: [{{name: u, user: {{token: secret}}}}]
contexts: [{{name: x, context: {{cluster: c, user: u}}}}]
current-context: x
"""


class Server:
    """Answers each request by what the test has put into `answers`; `requests` records them."""

    def __init__(self) -> None:
        self.requests: list[tuple[str, str, str, str]] = []
        self.answer: tuple[int, str] = (200, "{}")
        self.headers: dict[str, str] = {}

    async def handle(self, request: web.Request) -> web.Response:
        self.headers = dict(request.headers)
        self.requests.append((request.method, request.path, request.query_string, await request.text()))
        status, text = self.answer
        return web.Response(status=status, text=text, content_type="application/json")


@pytest.fixture
async def server() -> AsyncIterator[Server]:
    server = Server()
    app = web.Application()
    app.router.add_route("*", "/{rest:.*}", server.handle)
    runner = web.AppRunner(app)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    server.port = runner.addresses[0][1]  # type: ignore[attr-defined]
    yield server
    await runner.cleanup()


@pytest.fixture
async def api(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Api]:
    file = tmp_path / "kubeconfig"
    file.write_text(CONFIG.format(port=server.port))  # type: ignore[attr-defined]
    monkeypatch.setenv("KUBECONFIG", str(file))
    api = Api()
    await api.open()
    yield api
    await api.close()


async def test_requests_have_the_credentials_of_the_kubeconfig(api: Api, server: Server) -> None:
    server.answer = (200, '{"items": []}')
    assert await api.get("/api/v1/pods", labelSelector="a=b") == {"items": []}
    assert server.requests == [("GET", "/api/v1/pods", "labelSelector=a%3Db", "")]
    assert server.headers["Authorization"] == "Bearer secret"


async def test_apply_is_a_patch_in_the_name_of_one_manager(api: Api, server: Server) -> None:
    await api.apply("/api/v1/x/y", {"kind": "Y"})
    ((method, _, query, body),) = server.requests
    assert (method, query, json.loads(body)) == ("PATCH", "fieldManager=rce&force=true", {"kind": "Y"})
    assert server.headers["Content-Type"] == "application/apply-patch+yaml"


async def test_errors_have_the_message_of_kubernetes(api: Api, server: Server) -> None:
    server.answer = (404, '{"message": "pods \\"x\\" not found"}')
    with pytest.raises(NotFound, match='pods "x" not found'):
        await api.get("/api/v1/x")
    server.answer = (403, '{"message": "not allowed"}')
    with pytest.raises(Refused, match="refuses POST /api/v1/x: not allowed") as error:
        await api.create("/api/v1/x", {})
    assert error.value.status == 403
    server.answer = (502, "<html>")
    with pytest.raises(Refused, match="<html>"):
        await api.text("/log")


async def test_deletion_of_what_is_gone_or_replaced_does_nothing(api: Api, server: Server) -> None:
    assert await api.delete("/api/v1/x", 0, "u")
    assert json.loads(server.requests[0][3]) == {
        "propagationPolicy": "Background",
        "gracePeriodSeconds": 0,
        "preconditions": {"uid": "u"},
    }
    for status in (404, 409):
        server.answer = (status, "{}")
        assert not await api.delete("/api/v1/x")


async def test_watch_yields_events_until_the_server_ends_it(api: Api, server: Server) -> None:
    server.answer = (200, '{"type": "ADDED", "object": {"a": 1}}\n{"type": "DELETED", "object": {}}\n')
    assert [each async for each in api.watch("/api/v1/pods", "7")] == [Event("ADDED", {"a": 1}), Event("DELETED", {})]
    assert "resourceVersion=7" in server.requests[0][2]


async def test_watch_takes_objects_of_any_size(api: Api, server: Server) -> None:
    long = "x" * 1_000_000
    server.answer = (200, f'{{"type": "ADDED", "object": {{"a": "{long}"}}}}\n{{"type": "DELETED", "object": {{}}}}\n')
    assert [each async for each in api.watch("/api/v1/pods", "7")] == [
        Event("ADDED", {"a": long}),
        Event("DELETED", {}),
    ]


@pytest.mark.parametrize("line", ["?", "[]", '{"type": "ADDED"}', '{"type": 1, "object": {}}'])
async def test_malformed_event_is_an_error(api: Api, server: Server, line: str) -> None:
    server.answer = (200, line + "\n")
    with pytest.raises(Unavailable, match="does not answer"):
        async for _ in api.watch("/api/v1/pods", "7"):
            pass


async def test_expired_watch_is_an_error_with_its_status(api: Api, server: Server) -> None:
    server.answer = (200, '{"type": "ERROR", "object": {"code": 410, "message": "too old"}}\n')
    with pytest.raises(Refused, match="too old") as error:
        async for _ in api.watch("/api/v1/pods", "7"):
            pass
    assert error.value.status == GONE


async def test_server_that_is_away_is_unavailable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "kubeconfig"
    file.write_text(CONFIG.format(port=1))
    monkeypatch.setenv("KUBECONFIG", str(file))
    api = Api()
    await api.open()
    with pytest.raises(Unavailable, match="does not answer"):
        await api.get("/api/v1/pods")
    await api.close()


async def test_missing_configuration_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("KUBECONFIG", str(tmp_path / "missing"))
    with pytest.raises(Unavailable, match="set KUBECONFIG"):
        await Api().open()
