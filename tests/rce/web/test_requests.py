"""Requests as they were sent, malformed ones too."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from aiohttp import web
from aiohttp.test_utils import make_mocked_request
from multidict import CIMultiDict

from rce.web.requests import declared_length, header, host_name, raw_path, raw_query


def request(path: str = "/", **headers: str) -> web.BaseRequest:
    return make_mocked_request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})


def test_target_is_not_decoded() -> None:
    found = request("//a%20b/%ff?x=%2F&y")
    assert (raw_path(found), raw_query(found)) == ("//a%20b/%ff", "x=%2F&y")


@pytest.mark.parametrize(
    ("host", "name"),
    [
        ("cloud.example:9000", "cloud.example"),
        ("cloud.example", "cloud.example"),
        ("[::1]:9000", "::1"),
        ("[2001:db8::2]", "2001:db8::2"),
        ('e"vil\\', 'e"vil\\'),
        ("café", "caf?"),
    ],
)
def test_host_name(host: str, name: str) -> None:
    assert host_name(request(Host=host)) == name


def test_header_that_is_not_utf8_is_replaced() -> None:
    received: Any = SimpleNamespace(headers=CIMultiDict({"Authorization": "Basic \udcff"}))  # as aiohttp decodes it
    assert header(received, "Authorization") == "Basic �"
    assert header(request(), "Authorization") is None


def test_length_of_a_body() -> None:
    assert declared_length(request()) == 0
    assert declared_length(request(Content_Length="7")) == 7
    assert declared_length(request(Transfer_Encoding="chunked")) is None
