"""Errors as HTTP responses."""

from __future__ import annotations

import json

import pytest

from rce.errors import InternalError, InvalidName, LimitExceeded, NotFound, RceError, TooManyAttempts, Unauthorized
from rce.web.problems import STATUS, HttpError, MethodNotAllowed, problem_response, status_of


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (InvalidName("x"), 400),
        (Unauthorized("x"), 401),
        (NotFound("x"), 404),
        (LimitExceeded("x", limit=1), 413),
        (InternalError("x"), 500),
        (RceError("x"), 500),
        (MethodNotAllowed("x"), 405),
        (HttpError("x", status=412), 412),
    ],
)
def test_status_of_an_error(error: RceError, status: int) -> None:
    assert status_of(error) == status


def test_codes_that_are_not_listed_are_the_clients_fault() -> None:
    assert "invalid_request" not in STATUS
    assert all(400 < status < 600 for status in STATUS.values())


def test_problem_has_the_code_and_the_particulars() -> None:
    response = problem_response(LimitExceeded("too many", field="x", limit=1))
    assert (response.status, response.content_type) == (413, "application/problem+json")
    assert isinstance(response.body, bytes)
    assert json.loads(response.body) == {
        "title": "Limit exceeded",
        "status": 413,
        "detail": "too many",
        "code": "limit_exceeded",
        "field": "x",
        "fields": {"limit": 1},
    }


def test_headers_that_belong_to_a_status() -> None:
    assert problem_response(Unauthorized("x")).headers["WWW-Authenticate"] == 'Bearer realm="rce"'
    assert problem_response(TooManyAttempts("x", retry_after=7)).headers["Retry-After"] == "7"
    assert problem_response(MethodNotAllowed("x", headers={"Allow": "GET"})).headers["Allow"] == "GET"
