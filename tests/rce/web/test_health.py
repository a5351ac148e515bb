"""Answers of health checks."""

from __future__ import annotations

import msgspec

from rce.web.health import health


def test_status_is_503_while_something_is_missing() -> None:
    answer, status = health(["no connection to the Master"])
    assert status == 503
    assert msgspec.to_builtins(answer) == {"status": "missing", "missing": ["no connection to the Master"]}


def test_status_is_200_if_nothing_is_missing() -> None:
    answer, status = health([])
    assert (answer.status, status) == ("ok", 200)
