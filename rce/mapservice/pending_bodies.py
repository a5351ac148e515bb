"""Memory for the bodies of SOAP requests, which have to be read before their clients are known.

The credentials are in the body, beside a recording. So strangers can send large bodies over many connections, and all
of these share a budget. When it is exceeded, the largest body is refused: small requests always find room.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from aiohttp import web

from rce.errors import Unavailable
from rce.web.requests import body_pieces

BUDGET = 64 * 1024 * 1024  # bytes


class _Body:
    """A body that is being read, or whose client is not known yet."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.reading: asyncio.Timeout | None = None  # expires when the body is refused


class PendingBodies:
    """The bodies of all requests whose clients are not known yet."""

    def __init__(self, budget: int) -> None:
        """Begin; `budget` is the number of bytes."""
        self._budget = budget
        self._bodies: set[_Body] = set()

    @asynccontextmanager
    async def read(self, request: web.BaseRequest) -> AsyncIterator[bytes]:
        """Read a body; it counts until the end of the `with` statement.

        Raises:
            Unavailable: The budget is used up, and this is the largest of the bodies.
            web.HTTPException: As `read_accepted_body`.
        """
        body = _Body()
        self._bodies.add(body)
        try:
            try:
                async with asyncio.timeout(None) as body.reading:
                    await self._fill(body, request)
            except TimeoutError:
                raise Unavailable(
                    "too many large requests are under way: try again later, or upload the recording and submit its id"
                ) from None
            body.reading = None
            yield bytes(body.content)
        finally:
            self._bodies.discard(body)

    async def _fill(self, body: _Body, request: web.BaseRequest) -> None:
        async for piece in body_pieces(request):
            body.content += piece
            if len(body.content) > request.client_max_size:
                raise web.HTTPRequestEntityTooLarge(request.client_max_size)
            if sum(len(each.content) for each in self._bodies) > self._budget:
                self._refuse_largest()
            if body not in self._bodies:
                raise TimeoutError

    def _refuse_largest(self) -> None:
        largest = max((each for each in self._bodies if each.reading), key=lambda each: len(each.content))
        self._bodies.discard(largest)
        largest.content.clear()
        assert largest.reading is not None
        largest.reading.reschedule(asyncio.get_running_loop().time())
