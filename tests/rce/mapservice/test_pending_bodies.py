"""Memory for the bodies of requests whose clients are not known yet."""

from __future__ import annotations

import asyncio
from unittest.mock import Mock

import pytest
from aiohttp import streams, web
from aiohttp.base_protocol import BaseProtocol
from aiohttp.test_utils import make_mocked_request

from rce.errors import Unavailable
from rce.mapservice.pending_bodies import PendingBodies

BUDGET = 1000


class Sender:
    """A client that sends a body piece by piece, to a service that may take `largest` bytes of one."""

    def __init__(self, pending: PendingBodies, largest: int = 10_000) -> None:
        self.known = asyncio.Event()
        self.content = streams.StreamReader(Mock(BaseProtocol), 2**16, loop=asyncio.get_running_loop())
        self._request = make_mocked_request("POST", "/soap", payload=self.content, client_max_size=largest)
        self.reading = asyncio.create_task(self._read(pending))

    async def _read(self, pending: PendingBodies) -> int:
        async with pending.read(self._request) as body:
            await self.known.wait()
            return len(body)

    async def send(self, size: int, last: bool = False) -> None:
        self.content.feed_data(bytes(size))
        if last:
            self.content.feed_eof()
        for _ in range(5):  # turns of the loop until the service has read it
            await asyncio.sleep(0)

    async def end(self) -> int:
        self.known.set()
        return await self.reading


async def test_largest_body_is_refused_when_the_budget_is_used_up() -> None:
    pending = PendingBodies(BUDGET)
    large, small = Sender(pending), Sender(pending)
    await large.send(600)
    await small.send(300)
    assert not large.reading.done()
    await small.send(200)
    with pytest.raises(Unavailable, match="too many large requests"):
        await large.end()
    await small.send(400, last=True)
    assert await small.end() == 900


async def test_body_that_exceeds_the_budget_itself_is_refused() -> None:
    one = Sender(PendingBodies(BUDGET))
    await one.send(1001, last=True)
    with pytest.raises(Unavailable):
        await one.end()


async def test_body_counts_until_its_client_is_known() -> None:
    pending = PendingBodies(BUDGET)
    waiting, later = Sender(pending), Sender(pending)
    await waiting.send(900, last=True)
    await later.send(200)
    with pytest.raises(Unavailable):  # although the other is larger: that one is read already
        await later.end()
    assert await waiting.end() == 900
    again = Sender(pending)
    await again.send(900, last=True)
    assert await again.end() == 900


async def test_body_that_is_too_large_for_the_service_is_refused() -> None:
    one = Sender(PendingBodies(BUDGET), largest=100)
    await one.send(101)
    with pytest.raises(web.HTTPRequestEntityTooLarge):
        await one.end()
