"""The JavaScript client with the entries of several Masters: one is unreachable, and one is a standby."""

from __future__ import annotations

import asyncio

import pytest

from tests.support.e2e.node import run_script
from tests.support.fake_platform import PASSWORD, FakePlatform
from tests.support.paths import TESTS

TIMEOUT = 60


async def _refuse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    await reader.readuntil(b"\r\n\r\n")
    writer.write(b"HTTP/1.1 503 Unavailable\r\nContent-Length: 9\r\nConnection: close\r\n\r\na standby")
    writer.close()


@pytest.mark.slow
async def test_robot_connects_through_the_master_that_leads() -> None:
    script = str(TESTS / "js" / "two_masters.mjs")
    async with FakePlatform() as platform, await asyncio.start_server(_refuse, "127.0.0.1", 0) as server:
        standby = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/"
        urls = f"http://127.0.0.1:1/,{standby},{platform.url}"
        status, out, err = await run_script(script, urls, "testUser", PASSWORD, timeout=TIMEOUT)
        assert (status, out) == (0, "done\n"), err
        status, _, err = await run_script(script, standby, "testUser", PASSWORD, timeout=TIMEOUT)
        assert status != 0
        assert "a standby" in err
