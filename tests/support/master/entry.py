"""Requests to the robots' HTTP entry, and their answers."""

from __future__ import annotations

import asyncio
import http.client
from collections.abc import Awaitable, Callable
from typing import NamedTuple


class Answer(NamedTuple):
    status: int
    kind: str | None  # media type
    body: bytes
    location: str | None
    origins: str | None  # whose pages may read it


Ask = Callable[..., Awaitable[Answer]]
"""Makes one request: `await ask(path, method, Header=value)`."""


def asking(port: int) -> Ask:
    """Return a function that makes requests to this port."""

    def request(path: str, method: str = "GET", **headers: str) -> Answer:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        connection.request(method, path, headers={"Connection": "close", **headers})
        response = connection.getresponse()
        names = ("content-type", "location", "access-control-allow-origin")
        kind, location, origins = (response.getheader(name) for name in names)
        answer = Answer(response.status, kind, response.read(), location, origins)
        connection.close()
        return answer

    async def ask(path: str, method: str = "GET", **headers: str) -> Answer:
        return await asyncio.to_thread(request, path, method, **headers)

    return ask
