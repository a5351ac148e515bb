"""Repeated work, with pauses that tests count instead of waiting."""

from __future__ import annotations

import pytest
import sqlalchemy as sa
from twisted.logger import capturedLogs

from master.storage import periodic
from master.storage.periodic import repeat
from rce.errors import Unavailable


async def test_failures_of_the_database_are_logged_and_others_end_it(monkeypatch: pytest.MonkeyPatch) -> None:
    outcomes: list[Exception | None] = [None, Unavailable("away"), sa.exc.OperationalError("x", {}, OSError()), None]
    outcomes.append(ZeroDivisionError("a defect"))
    pauses: list[float] = []

    async def pause(seconds: float) -> None:
        pauses.append(seconds)

    async def work() -> None:
        outcome = outcomes.pop(0)
        if outcome is not None:
            raise outcome

    monkeypatch.setattr(periodic.asyncio, "sleep", pause)
    with capturedLogs() as events, pytest.raises(ZeroDivisionError):
        await repeat(5.0, work, "it could not be read")
    assert pauses == [5.0] * 5
    assert [event["failed"] for event in events] == ["it could not be read"] * 2
    assert events[0]["error"] == "away"
