"""Blocking client of the platform's HTTP API (`/api/v1`), which decodes responses into typed structs.

Only the standard library and msgspec are needed.
"""

from __future__ import annotations

import http.client
import secrets
from collections.abc import Iterator
from typing import Any, TypeVar
from urllib.parse import quote, urlencode

import msgspec
from msgspec import Struct

from rce.api.http import EntryClient, basic, bearer
from rce.api.views.pages import Page
from rce.errors import MALFORMED, Unavailable

PREFIX = "api/v1"
PAGE_SIZE = 1000  # maximum of the API

T = TypeVar("T")


class ServerEvent(Struct, frozen=True):
    """Server-sent event: its name, its data (mostly JSON) and its id."""

    event: str
    data: str
    id: str = ""


class ApiClient:
    """Client of one platform's API.

    `parts` of a path are names, which are quoted; query arguments without a value are left out. All methods raise
    `Unavailable` if there is no response, and otherwise the error of `rce.errors` with which the platform answers.

    Attributes:
        entry: The HTTP client that is used.
    """

    def __init__(self, url: str, *, user: str = "", password: str | None = None, key: str | None = None) -> None:
        """Prepare a client; nothing is sent yet.

        Args:
            url: URL of the platform's entry.
            user: User name, with a password.
            password: Password in clear.
            key: API key in place of user and password.

        Raises:
            InvalidRequest: The URL is not http or https.
        """
        headers = bearer(key) if key else basic(user, password or "")
        self.entry = EntryClient(url, headers)

    def get(self, kind: type[T], *parts: str, **query: object) -> T:
        """Return the resource at a path, decoded as `kind`."""
        return _decode(self.entry.json("GET", path_of(parts, query)), kind)

    def items(self, kind: type[T], *parts: str, limit: int | None = None, **query: object) -> Iterator[T]:
        """Yield the items of a list, requesting pages as they are needed; at most `limit` items unless it is None."""
        after, left = "", limit
        while left is None or left > 0:
            size = PAGE_SIZE if left is None else min(left, PAGE_SIZE)
            page = self.get(Page[kind], *parts, limit=size, after=after, **query)  # type: ignore[valid-type]
            yield from page.items
            after, left = page.next, None if left is None else left - len(page.items)
            if not after:
                return

    def post(self, kind: type[T], *parts: str, body: object = None, **query: object) -> T:
        """Create a resource and return the response; its idempotency key protects against repetition by a proxy."""
        result: T = self._send("POST", kind, parts, query, body, **{"Idempotency-Key": secrets.token_hex(16)})
        return result

    def put(self, *parts: str, body: object = None, **query: object) -> None:
        """Set a resource."""
        self._send("PUT", Any, parts, query, body)

    def patch(self, kind: type[T], *parts: str, body: object = None, **query: object) -> T:
        """Change the fields of a resource that are in `body`, and return the response."""
        result: T = self._send("PATCH", kind, parts, query, body)
        return result

    def delete(self, *parts: str, **query: object) -> None:
        """Remove a resource."""
        self._send("DELETE", Any, parts, query, None)

    def follow(self, *parts: str, **query: object) -> Iterator[ServerEvent]:
        """Yield server-sent events until the platform ends the stream. Close the iterator to stop."""
        headers = {"Accept": "text/event-stream"}
        with self.entry.open("GET", path_of(parts, query), None, **headers) as response:
            yield from read_events(_lines(response))

    def _send(
        self, method: str, kind: Any, parts: tuple[str, ...], query: dict[str, object], body: object, **headers: str
    ) -> Any:
        content = None if body is None else msgspec.json.encode(body)
        headers["Content-Type"] = "application/json"
        with self.entry.open(method, path_of(parts, query), content, **headers) as response:
            text = response.read()
        return _decode(text, kind) if text else None


def path_of(parts: tuple[str, ...], query: dict[str, object]) -> str:
    """Return the path of a resource relative to the entry."""
    path = "/".join([PREFIX, *(quote(part, safe="") for part in parts)])
    arguments = {name: _query_value(value) for name, value in query.items() if not _is_absent(value)}
    return f"{path}?{urlencode(arguments)}" if arguments else path


def read_events(lines: Iterator[str]) -> Iterator[ServerEvent]:
    """Parse server-sent events (HTML Living Standard, 9.2.6); blocks without data are no events."""
    event, event_id = "", ""
    data: list[str] = []
    for line in lines:
        if not line:
            if data:
                yield ServerEvent(event or "message", "\n".join(data), event_id)
            event, data = "", []
            continue
        field, _, value = line.partition(":")
        value = value.removeprefix(" ")
        match field:
            case "event":
                event = value
            case "data":
                data.append(value)
            case "id":
                event_id = value


def _lines(response: Any) -> Iterator[str]:
    try:
        for line in response:
            yield line.decode(errors="replace").rstrip("\r\n")
    except (OSError, http.client.HTTPException) as error:
        raise Unavailable(f"the connection broke during the stream of events: {error}") from None


def _is_absent(value: object) -> bool:
    return value is None or value is False or value in ("", [])  # 0, which equals False, is a value


def _query_value(value: object) -> str:
    return "true" if value is True else str(value)


def _decode(body: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(body, type=kind)
    except MALFORMED as error:
        raise Unavailable(f"this version cannot read the platform's response: {error}") from None
