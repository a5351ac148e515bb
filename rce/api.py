"""A blocking client of the platform's API (`/api/v1`), typed by the structs that the answers are read as.

Nothing but the standard library and msgspec, so that a robot's installation has it too.
"""

from __future__ import annotations

import http.client
import secrets
from collections.abc import Iterator
from typing import Any, TypeVar
from urllib.parse import quote, urlencode

import msgspec
from msgspec import Struct

from rce.errors import Unavailable
from rce.http import Entry, basic, bearer
from rce.views.pages import Page

PREFIX = "api/v1"
PAGE = 1000  # the most that one answer lists

T = TypeVar("T")


class ServerEvent(Struct, frozen=True):
    """A server-sent event: its name, its data (JSON mostly) and its id."""

    event: str
    data: str
    id: str = ""


class Api:
    """The API of the entry at `url`, with an API key, or with a user and the password.

    All methods raise what the platform answers (`rce.errors`), and Unavailable when nobody does. `parts` of paths are
    names as they are; queries without a value are left out.
    """

    def __init__(self, url: str, *, user: str = "", password: str | None = None, key: str | None = None) -> None:
        headers = bearer(key) if key else basic(user, password or "")
        self.entry = Entry(url, headers)

    def get(self, kind: type[T], *parts: str, **query: object) -> T:
        """What is at a path."""
        return _decode(self.entry.json("GET", path_of(parts, query)), kind)

    def items(self, kind: type[T], *parts: str, limit: int = 0, **query: object) -> Iterator[T]:
        """A list, page by page as it is read; `limit` items at most, 0 for all."""
        after, left = "", limit
        while True:
            size = min(left, PAGE) if limit else PAGE
            page = self.get(Page[kind], *parts, limit=size, after=after, **query)  # type: ignore[valid-type]
            yield from page.items
            after, left = page.next, left - len(page.items)
            if not after or (limit and left <= 0):
                return

    def post(self, kind: type[T], *parts: str, body: object = None, **query: object) -> T:
        """Make something. Sent with a key of its own, so that a proxy that repeats it makes it once."""
        answer: T = self._send("POST", kind, parts, query, body, **{"Idempotency-Key": secrets.token_hex(16)})
        return answer

    def put(self, *parts: str, body: object = None, **query: object) -> None:
        """Set something."""
        self._send("PUT", Any, parts, query, body)

    def patch(self, kind: type[T], *parts: str, body: object = None, **query: object) -> T:
        """Change what is named in `body`."""
        answer: T = self._send("PATCH", kind, parts, query, body)
        return answer

    def delete(self, *parts: str, **query: object) -> None:
        """Remove something."""
        self._send("DELETE", Any, parts, query, None)

    def follow(self, *parts: str, **query: object) -> Iterator[ServerEvent]:
        """Events as they come, until the platform ends the stream. Close the iterator to stop."""
        headers = {"Accept": "text/event-stream"}
        with self.entry.open("GET", path_of(parts, query), None, **headers) as answer:
            yield from read_events(_lines(answer))

    def _send(
        self, method: str, kind: Any, parts: tuple[str, ...], query: dict[str, object], body: object, **headers: str
    ) -> Any:
        content = None if body is None else msgspec.json.encode(body)
        headers["Content-Type"] = "application/json"
        with self.entry.open(method, path_of(parts, query), content, **headers) as answer:
            text = answer.read()
        return _decode(text, kind) if text else None


def path_of(parts: tuple[str, ...], query: dict[str, object]) -> str:
    """The path of a resource below the entry."""
    path = "/".join([PREFIX, *(quote(part, safe="") for part in parts)])
    given = {name: _said(value) for name, value in query.items() if value not in (None, "", False, [])}
    return f"{path}?{urlencode(given)}" if given else path


def read_events(lines: Iterator[str]) -> Iterator[ServerEvent]:
    """Server-sent events out of their lines (HTML Living Standard, 9.2.6); those without data are no events."""
    event, name = "", ""
    data: list[str] = []
    for line in lines:
        if not line:
            if data:
                yield ServerEvent(event or "message", "\n".join(data), name)
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
                name = value


def _lines(answer: Any) -> Iterator[str]:
    try:
        for line in answer:
            yield line.decode(errors="replace").rstrip("\r\n")
    except (OSError, http.client.HTTPException) as error:
        raise Unavailable(f"the stream of events broke off: {error}") from None


def _said(value: object) -> str:
    return "true" if value is True else str(value)


def _decode(body: bytes, kind: type[T]) -> T:
    try:
        return msgspec.json.decode(body, type=kind)
    except msgspec.DecodeError as error:
        raise Unavailable(f"the platform answered what this version cannot read: {error}") from None
