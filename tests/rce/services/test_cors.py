"""Answers to pages of other origins."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest
from aiohttp import web
from aiohttp.test_utils import TestClient, TestServer

from rce.services.cors import allow_origins
from rce.services.problems import problems

Client = TestClient[web.Request, web.Application]
PAGE = {"Origin": "http://master.example", "Sec-Fetch-Site": "cross-site"}


async def take(_: web.Request) -> web.Response:
    return web.Response(text="taken")


@pytest.fixture
async def client() -> AsyncIterator[Client]:
    application = web.Application(middlewares=[problems])
    allow_origins(application)
    application.router.add_post("/jobs", take)
    async with TestClient(TestServer(application)) as client:
        yield client


async def test_page_of_another_origin_may_ask_and_send_with_a_key(client: Client) -> None:
    asked = await client.options("/jobs", headers={**PAGE, "Access-Control-Request-Method": "POST"})
    assert asked.status == 204
    assert asked.headers["Access-Control-Allow-Origin"] == "*"
    assert "Authorization" in asked.headers["Access-Control-Allow-Headers"]
    answer = await client.post("/jobs", headers={**PAGE, "Authorization": "Bearer rce_key"})
    assert (answer.status, answer.headers["Access-Control-Allow-Origin"]) == (200, "*")


async def test_change_without_a_key_is_refused_to_pages_of_other_sites(client: Client) -> None:
    for headers in (PAGE, {**PAGE, "Authorization": "Basic YTpi"}):
        assert (await client.post("/jobs", headers=headers)).status == 403
