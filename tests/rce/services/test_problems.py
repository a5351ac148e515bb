"""Errors of a service as problem+json, and decoding of what clients send."""

from __future__ import annotations

import asyncio
import errno
import json
from collections.abc import Awaitable, Callable
from typing import Any
from urllib.parse import urlsplit

import pytest
from aiohttp import web
from aiohttp.test_utils import make_mocked_request
from msgspec import Struct
from twisted.logger import LogEvent

from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.services.auditing import FAILED
from rce.services.problems import convert, decode, problems
from tests.support.map_service import Service


class Size(Struct):
    width: int


class Wanted(Struct):
    sizes: list[Size]
    share: float = 1.0
    name: str = ""


def failing(error: BaseException) -> Callable[[web.Request], Awaitable[web.StreamResponse]]:
    async def handler(_: web.Request) -> web.StreamResponse:
        raise error

    return handler


async def answered(error: BaseException) -> tuple[int, dict[str, Any], web.Request]:
    """Return status and body of the answer to a request whose handler fails, and the request."""
    request = make_mocked_request("GET", "/x", headers={"Host": "here"})
    answer = await problems(request, failing(error))
    assert isinstance(answer, web.Response)
    assert isinstance(answer.body, bytes)
    return answer.status, json.loads(answer.body), request


@pytest.mark.parametrize(
    ("error", "status", "code"),
    [
        (NotFound("no such job"), 404, "not_found"),
        (web.HTTPNotFound(), 404, "not_found"),
        (web.HTTPRequestEntityTooLarge(9, 10), 413, "invalid_request"),
        (OSError(errno.ENOSPC, "No space left on device"), 503, "unavailable"),
        (KeyError("a defect"), 500, "internal"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, Exception) else None,
)
async def test_every_error_is_answered_with_a_problem(error: Exception, status: int, code: str) -> None:
    found, problem, request = await answered(error)
    assert (found, problem["status"], problem["code"]) == (status, status, code)
    assert request[FAILED] == code


async def test_client_does_not_see_what_a_defect_is(failures: list[LogEvent]) -> None:
    _, problem, _ = await answered(KeyError("/secret/path"))
    assert "/secret/path" not in json.dumps(problem)
    (event,) = failures
    assert "/secret/path" in event["log_failure"].getTraceback()


async def test_method_not_allowed_names_the_allowed_ones() -> None:
    answer = await problems(
        make_mocked_request("PUT", "/x", headers={"Host": "here"}), failing(web.HTTPMethodNotAllowed("PUT", ["GET"]))
    )
    assert (answer.status, answer.headers["Allow"]) == (405, "GET")


async def test_disconnected_client_gets_no_answer() -> None:
    with pytest.raises(ConnectionResetError):
        await answered(ConnectionResetError())


@pytest.mark.parametrize(
    ("body", "field"),
    [
        (b"{", ""),
        (b"[]", ""),
        (b"{}", ""),
        (b'{"sizes": [{"width": 1}, {"width": "2"}]}', "sizes[1].width"),
        (b'{"sizes": [], "share": "x"}', "share"),
        (b'{"sizes": [], "name": "\xff"}', ""),
        (b"[" * 100_000, ""),
    ],
    ids=["cut", "array", "empty", "nested", "text", "bytes", "deep"],
)
def test_error_names_the_value_at_fault(body: bytes, field: str) -> None:
    with pytest.raises(InvalidRequest) as wrong:
        decode(body, Wanted)
    assert wrong.value.field == field
    assert str(wrong.value).startswith(f"{field}: " if field else "")


def test_body_with_too_many_values_is_refused() -> None:
    """Two million strings instead of at most 64 took 1.4 s."""
    with pytest.raises(LimitExceeded, match="the body has more than 10000 values"):
        decode(b'{"sizes": [' + b",".join([b"0"] * 10_002) + b"]}", Wanted)


def test_numbers_may_be_text_in_other_forms_than_json() -> None:
    assert convert({"sizes": [{"width": "3"}], "share": "0.5"}, Wanted) == Wanted([Size(3)], 0.5)
    assert decode(b'{"sizes": [{"width": "3"}]}', Wanted, strict=False) == Wanted([Size(3)])
    with pytest.raises(InvalidRequest) as wrong:
        convert({"sizes": [{"width": "wide"}]}, Wanted)
    assert wrong.value.field == "sizes[0].width"


@pytest.mark.parametrize("header", [b"Authorization: Bearer \xff", b"Host: a b:c", b"Host: \xff"])
async def test_malformed_headers_are_refused(service: Service, header: bytes) -> None:
    url = urlsplit(service.url)
    for more in (b"", b"Expect: 100-continue\r\n"):
        reader, writer = await asyncio.open_connection(url.hostname, url.port)
        host = b"" if header.startswith(b"Host") else b"Host: a\r\n"
        writer.write(b"POST /map-service/jobs HTTP/1.1\r\nContent-Length: 0\r\n" + host + more + header + b"\r\n\r\n")
        assert b" 400 " in await asyncio.wait_for(reader.readline(), 20)
        writer.close()


async def test_unknown_paths_and_methods_are_refused(service: Service) -> None:
    for path in ("/nothing", "/jobs/x/y/z"):
        answer = await service.request("GET", path)
        assert (answer.status, answer.content_type) == (404, "application/problem+json")
    assert (await service.request("PUT", "/jobs")).status == 405
    assert (await service.request("POST", "/jobs", data=b"x" * 100_000)).status == 413
