"""Tickets: valid once, and for a while."""

from __future__ import annotations

import time

import pytest

from master.access.tickets import Tickets


def test_ticket_is_valid_once() -> None:
    tickets: Tickets[str] = Tickets(60.0)
    token = tickets.issue("archive")
    assert tickets.take(token) == "archive"
    assert tickets.take(token) is None
    assert tickets.take("another") is None


def test_ticket_expires(monkeypatch: pytest.MonkeyPatch) -> None:
    tickets: Tickets[str] = Tickets(60.0)
    token = tickets.issue("archive")
    assert tickets.outstanding() == ["archive"]
    later = time.monotonic() + 61
    monkeypatch.setattr(time, "monotonic", lambda: later)
    assert tickets.outstanding() == []
    assert tickets.take(token) is None
