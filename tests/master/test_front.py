"""Front: what a standby answers, and the Master when it leads."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from master import front
from master.front import Front, standby_response
from rce.errors import Unavailable
from tests.support.control import HELLO

LEADER = "https://other:9000/"


class FakeLease:
    """A lease as it is told to be."""

    leader = LEADER
    holds = False
    term = 1


class FakePart:
    """Master and site of it."""

    async def handle(self, request: web.BaseRequest) -> web.StreamResponse:
        return web.Response(text="served")

    async def join(self, hello: Any, address: str) -> str:
        return "joined"


async def ask(path: str, leader: str = LEADER, accept: str = "*/*") -> tuple[int, str, Any]:
    async def handle(request: web.BaseRequest) -> web.StreamResponse:
        return standby_response(request, leader)

    async with TestClient(TestServer(_application(handle))) as client:
        response = await client.get(path, headers={"Accept": accept}, allow_redirects=False)
        return response.status, await response.text(), response.headers


def _application(handle: Any) -> web.Application:
    application = web.Application()
    application.router.add_route("*", "/{path:.*}", handle)
    return application


async def test_programs_are_told_who_leads() -> None:
    status, text, headers = await ask("/api/v1/environments")
    assert status == 503
    assert f'"leader":"{LEADER}"' in text
    assert headers["Retry-After"] == "1"
    assert "Location" not in headers


async def test_robots_are_told_who_leads() -> None:
    status, text, _ = await ask("/?userID=ann&version=20130531")
    assert (status, text) == (
        503,
        f"this Master is a standby: {LEADER} leads; name all Masters, and try again\n",
    )


@pytest.mark.parametrize(("path", "accept"), [("/ui/", "*/*"), ("/", "text/html")])
async def test_browsers_are_redirected(path: str, accept: str) -> None:
    status, _, headers = await ask(path, accept=accept)
    assert (status, headers["Location"]) == (307, "https://other:9000" + path)


async def test_standby_is_alive_and_not_ready() -> None:
    assert (await ask("/healthz"))[0] == 200
    assert (await ask("/readyz"))[0] == 503


async def test_without_a_leader_nobody_is_named() -> None:
    status, text, _ = await ask("/ui/", leader="")
    assert (status, text) == (503, "this Master is a standby; name all Masters, and try again\n")


async def test_requests_are_served_while_this_master_leads() -> None:
    lease: Any = FakeLease()
    door, part = Front(lease), FakePart()
    async with TestClient(TestServer(_application(door.handle))) as client:
        assert (await client.get("/api/v1/robots")).status == 503
        door.lead(part, part)  # type: ignore[arg-type]
        assert (await client.get("/api/v1/robots")).status == 503  # its lease has ended meanwhile
        lease.holds = True
        assert await (await client.get("/api/v1/robots")).text() == "served"


async def test_process_that_asks_a_standby_waits_for_it_to_lead(monkeypatch: pytest.MonkeyPatch) -> None:
    lease: Any = FakeLease()
    door, part = Front(lease), FakePart()
    joining = asyncio.create_task(door.join(HELLO, "here"))
    await asyncio.sleep(0)
    door.lead(part, part)  # type: ignore[arg-type]
    assert await joining == "joined"  # type: ignore[comparison-overlap]
    monkeypatch.setattr(front, "PATIENCE", 0.01)
    with pytest.raises(Unavailable, match="other:9000/ leads"):
        await Front(lease).join(HELLO, "here")


async def test_waiting_process_is_refused_when_the_standby_ends() -> None:
    lease: Any = FakeLease()
    door = Front(lease)
    joining = asyncio.create_task(door.join(HELLO, "here"))
    await asyncio.sleep(0)
    door.close()
    with pytest.raises(Unavailable, match="is a standby"):
        await joining


async def test_master_without_a_lease_serves() -> None:
    door, part = Front(), FakePart()
    door.lead(part, part)  # type: ignore[arg-type]
    async with TestClient(TestServer(_application(door.handle))) as client:
        assert await (await client.get("/")).text() == "served"
