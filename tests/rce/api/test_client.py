"""Paths, pages and server-sent events of the API client; tests/master/api has it at a real Master."""

from __future__ import annotations

from typing import Any
from urllib.parse import parse_qs, urlsplit

import msgspec
import pytest

from rce.api.client import PAGE_SIZE, ApiClient, ServerEvent, path_of, read_events
from rce.errors import Unavailable


class FakeEntry:
    """Entry with a list of numbers, in pages of at most 1000."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.paths: list[str] = []

    def json(self, method: str, path: str, body: Any = None) -> bytes:
        self.paths.append(path)
        query = parse_qs(urlsplit(path).query)
        start, size = int(query.get("after", ["0"])[0]), int(query["limit"][0])
        end = min(start + size, self.count)
        return msgspec.json.encode({"items": list(range(start, end)), "next": str(end) if end < self.count else ""})


def client(entry: object) -> ApiClient:
    api = ApiClient("http://127.0.0.1:1/", key="key")
    api.entry = entry  # type: ignore[assignment]
    return api


def test_path_quotes_names_and_omits_empty_arguments() -> None:
    query: dict[str, object] = {"user": "ann", "follow": True, "limit": 5, "lines": 0}
    query |= {"after": "", "kinds": [], "quiet": False, "none": None}
    assert path_of(("a b", "x/y"), query) == "api/v1/a%20b/x%2Fy?user=ann&follow=true&limit=5&lines=0"
    assert path_of(("robots",), {}) == "api/v1/robots"


def test_items_are_requested_page_by_page() -> None:
    entry = FakeEntry(2 * PAGE_SIZE + 1)
    items = client(entry).items(int, "numbers")
    assert next(items) == 0
    assert len(entry.paths) == 1
    assert list(items) == list(range(1, 2 * PAGE_SIZE + 1))
    assert len(entry.paths) == 3


@pytest.mark.parametrize("limit", [0, 1, PAGE_SIZE, PAGE_SIZE + 1])
def test_items_are_limited(limit: int) -> None:
    assert len(list(client(FakeEntry(10 * PAGE_SIZE)).items(int, "numbers", limit=limit))) == limit


def test_unreadable_response_is_unavailable() -> None:
    class Html:
        def json(self, *_: Any) -> bytes:
            return b"<html>"

    with pytest.raises(Unavailable, match="cannot read"):
        client(Html()).get(int, "x")


def test_server_sent_events() -> None:
    lines = [
        "id: 1",
        "event: made",
        "data: a",
        "data:b",
        "",
        ": comment",
        "event: empty",
        "",
        "data: c",
        "",
        "data: cut",
    ]
    assert list(read_events(iter(lines))) == [ServerEvent("made", "a\nb", "1"), ServerEvent("message", "c", "1")]
