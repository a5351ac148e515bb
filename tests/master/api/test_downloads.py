"""Downloads that cannot go on; `test_recordings.py` has those that can."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

import aiohttp
import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer

from master.api.downloads import Download
from rce.errors import Unavailable


async def fetch(read: Callable[[int, int], Awaitable[bytes]], size: int) -> bytes:
    async def handle(request: web.BaseRequest) -> web.StreamResponse:
        return await Download("a", size, read).send(request, {})

    application = web.Application()
    application.router.add_get("/", handle)
    async with (
        TestServer(application) as server,
        aiohttp.ClientSession() as session,
        session.get(server.make_url("/")) as answer,
    ):
        return await answer.read()


async def test_empty_file_is_downloaded() -> None:
    async def read(offset: int, length: int) -> bytes:
        return b""

    assert await fetch(read, 0) == b""


@pytest.mark.parametrize("fails", [True, False], ids=["error", "shorter"])
async def test_download_that_cannot_go_on_breaks_off(fails: bool) -> None:
    async def read(offset: int, length: int) -> bytes:
        if offset and fails:
            raise Unavailable("the machine is away")
        return b"" if offset else b"x"

    with pytest.raises(aiohttp.ClientError):
        await fetch(read, 10)
