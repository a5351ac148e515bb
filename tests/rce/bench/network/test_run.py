"""Run of the benchmark of bad networks: its outages."""

from __future__ import annotations

from typing import cast

import pytest

from rce.bench.network import run
from rce.bench.network.lab import Lab
from rce.bench.network.line import PROFILES
from rce.bench.network.run import Result


class FakeLab:
    """Lab that notes what happens to its line."""

    def __init__(self) -> None:
        self.events: list[object] = []

    def set_up(self, up: bool) -> None:
        self.events.append(up)

    def move(self) -> None:
        self.events.append("move")


@pytest.mark.parametrize(
    ("profile", "events"),
    [("lte", []), ("tunnel", [False, True, False, True]), ("address-change", ["move", "move"])],
)
async def test_outages_and_moves_of_the_profile_happen(
    profile: str, events: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def sleep(seconds: float) -> None: ...

    monkeypatch.setattr(run.asyncio, "sleep", sleep)
    place, result = FakeLab(), Result(profile, "rce", 1.0, {})
    await run._fail(cast(Lab, place), result)
    assert place.events == events
    assert len(result.ended) == len(PROFILES[profile].outages) + len(PROFILES[profile].moves)
