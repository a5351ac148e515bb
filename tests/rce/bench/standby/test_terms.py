"""Writes that were acknowledged in the term of another Master."""

from __future__ import annotations

import pytest

from rce.bench.standby.terms import LATE, Leadership, Write, stale

A, B = "http://a/", "http://b/"
TERMS = [Leadership(1, A, 0.0), Leadership(2, B, 10.0), Leadership(3, A, 20.0)]


@pytest.mark.parametrize(
    "write",
    [
        Write(A, 5.0, 6.0),
        Write(A, 9.0, 11.0),  # it may have been stored before the other one led
        Write(A, 10.0 + LATE / 2, 10.3),  # the term may have been seen late
        Write(A, 19.0, 21.0),
        Write(B, 11.0, 12.0),
        Write(A, 25.0, 26.0),
    ],
)
def test_writes_of_the_leader_are_good(write: Write) -> None:
    assert stale([write], TERMS) == []


@pytest.mark.parametrize("write", [Write(A, 11.0, 12.0), Write(B, 5.0, 6.0), Write(B, 22.0, 30.0)])
def test_writes_in_the_term_of_another_one_are_found(write: Write) -> None:
    (found,) = stale([write], TERMS)
    assert f"{write.url} acknowledged a write in term" in found
