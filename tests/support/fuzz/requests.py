"""Requests of a user who is logged in, with a mutated header, path or body."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from typing import Any

from tests.support.endpoints.raw_robot import USER
from tests.support.fuzz.mutation import Mutator
from tests.support.fuzz.sockets import RawConnection

LOGIN = base64.b64encode(f"{USER}:{USER}".encode()).decode()
Parts = tuple[str, str, dict[str, str], Any]
"""Method, path, headers and body, which is bytes or becomes JSON."""


def mutated(
    mutator: Mutator, prefix: str, requests: Sequence[Parts], always: Callable[[bytes], bool] = lambda _: False
) -> bytes:
    """Return one of the requests with something mutated; its length is right.

    Args:
        mutator: Source of chance.
        prefix: Prefix of all paths.
        requests: The requests.
        always: Tells which bodies are damaged in each case.
    """
    method, path, headers, body = mutator.choose(tuple(requests))
    if not isinstance(body, bytes):
        body = mutator.json(body)
    elif mutator.chance(0.6) or always(body):
        body = mutator.damage(body)
    headers = dict(headers)
    if headers and mutator.chance(0.4):
        name = mutator.choose(tuple(headers))
        headers[name] = _printable(mutator, headers[name])
    path = "/" + _printable(mutator, path[1:]).replace(" ", "") if mutator.chance(0.2) else path
    lines = [f"{method} {prefix}{path} HTTP/1.1", "Host: x", f"Authorization: Basic {LOGIN}", "Connection: close"]
    lines += [f"{name}: {value}" for name, value in headers.items()] + [f"Content-Length: {len(body)}", "", ""]
    return "\r\n".join(lines).encode() + body


async def ask(port: int, request: bytes) -> bytes:
    """Send a request and return all that comes back."""
    connection = await RawConnection.open(port, "127.0.0.1")
    await connection.send(request)
    while await connection.receive():
        pass
    return bytes(connection.received)


def _printable(mutator: Mutator, text: str) -> str:
    return "".join(letter for letter in mutator.damage(text.encode()).decode("latin-1") if " " <= letter <= "~")
