"""The bench of localisation."""

from __future__ import annotations

from pathlib import Path

import pytest

from rce.bench.localisation import Figure, measure, table
from rce.errors import InvalidRequest
from tests.support.recordings import carmen, flaser


def test_recording_that_is_too_short_is_refused(tmp_path: Path) -> None:
    log = carmen(tmp_path / "short.clf", "".join(flaser(float(i)) for i in range(10)))
    with pytest.raises(InvalidRequest, match="10 scans, too few for 3 parts of 20"):
        measure(log, 3, 20)


def test_parts_of_the_second_half_are_localised(tmp_path: Path) -> None:
    """Four beams determine no pose: the robot is found nowhere, and everywhere outside."""
    log = carmen(tmp_path / "poor.clf", "".join(flaser(float(i), 0.1 * i) for i in range(40)))
    figures = measure(log, 2, 10)
    assert [(each.start, each.first, each.known) for each in figures] == [(20, None, 0.0), (30, None, 0.0)]


def test_table_tells_what_was_not_found() -> None:
    lines = table([Figure(9, 1.0, 3, 0.98, 0.0, 0.021, 0.1, 1.44), Figure(30, 0.1, None, 0, None, None, None, None)])
    assert lines.splitlines()[2:] == [
        "| 9 | 100% | 3 scans | 98% | 0% | 0.021 m, 0.10° | 1.4 ms |",
        "| 30 | 10% | not | 0% | | | |",
    ]
