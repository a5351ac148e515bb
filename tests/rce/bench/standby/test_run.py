"""A failed run is told with its seed; tests/chaos/test_standby.py does a run."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from rce.bench.chaos.violations import Violation
from rce.bench.standby import run


async def test_failure_has_its_reasons_and_the_seed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @asynccontextmanager
    async def running(_: Path) -> AsyncIterator[None]:
        yield

    class Failing:
        def __init__(self, *_: Any) -> None:
            pass

        async def measure(self) -> None:
            raise ExceptionGroup("", [Violation("missing: key k")])

    monkeypatch.setattr(run, "running", running)
    monkeypatch.setattr(run, "Run", Failing)
    with pytest.raises(Violation, match=r"^Violation: missing: key k\nseed 7, "):
        await run.measure(tmp_path, run.Plan(seed=7, events=1, seconds=1))
