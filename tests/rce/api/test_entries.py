"""URLs of the entries of a platform."""

from __future__ import annotations

import pytest

from rce.api.entries import entries
from rce.errors import InvalidRequest


def test_entries_are_separated_by_commas() -> None:
    assert entries("http://a/") == ["http://a/"]
    assert entries("http://a/, https://b:9000/,") == ["http://a/", "https://b:9000/"]


@pytest.mark.parametrize("urls", ["", ",", "ftp://a/", "http://a/,b"])
def test_other_texts_are_refused(urls: str) -> None:
    with pytest.raises(InvalidRequest, match="must begin with http:// or https://"):
        entries(urls)


@pytest.mark.parametrize("urls", ["http://", "http://[::1", "http://a:99999/", "http://a:x/", "http://a:0/"])
def test_url_without_a_valid_address_is_refused(urls: str) -> None:
    with pytest.raises(InvalidRequest, match="write http://HOST:PORT/"):
        entries(urls)
