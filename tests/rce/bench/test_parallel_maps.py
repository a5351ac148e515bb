"""Benchmark of mapping by several workers."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from rce.bench import parallel_maps
from rce.bench.parallel_maps import as_data, as_text, compute, cut, kinds, measure, scheduled
from rce.client import Robot
from rce.mapping.parallel.crew import UnitRecord
from rce.mapping.parallel.run import Method, ParallelRun
from rce.mapping.scans import Scan

UNITS = [UnitRecord(1, "map_part", 0, 2.0, 3.0, 10, 20)] * 4 + [UnitRecord(2, "find_overlaps", 0, 1.0, 1.5, 30, 40)] * 2
SCANS = [Scan(float(stamp), np.zeros(0, np.float32), 0.0, 0.1, 1.0) for stamp in range(100)]


def test_cut_recordings_overlap() -> None:
    first, second, third = cut(SCANS, 3)
    assert (first[0].stamp, third[-1].stamp) == (0.0, 99.0)
    for before, after in ((first, second), (second, third)):
        assert 8 <= len({scan.stamp for scan in before} & {scan.stamp for scan in after}) <= 10
    assert cut(SCANS, 1) == [SCANS]


def test_costs_are_summed_by_kind() -> None:
    one, two = kinds(UNITS)
    assert (one.kind, one.units, one.seconds, one.exchange, one.sent, one.received) == ("map_part", 4, 8.0, 4.0, 40, 80)
    assert (two.kind, two.units) == ("find_overlaps", 2)


@pytest.mark.parametrize(("machines", "seconds"), [(1, 15.0), (2, 7.5), (3, 7.5), (16, 4.5)])
def test_phases_are_scheduled_one_after_the_other(machines: int, seconds: float) -> None:
    assert scheduled(UNITS, machines) == seconds


def test_what_the_job_does_itself_remains_with_any_number_of_machines() -> None:
    computed = {each.machines: each for each in compute(20.0, UNITS, 1)}
    assert (computed[1].seconds, computed[1].speedup) == (20.0, 1.0)
    assert (computed[16].seconds, computed[16].speedup) == (9.5, pytest.approx(20 / 9.5))


async def test_each_number_of_workers_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    async def run(robot: Robot, name: str, recordings: Any, method: Method) -> ParallelRun:
        asked.append((name, len(recordings), method.workers))
        return ParallelRun([], UNITS, 0)

    monkeypatch.setattr(parallel_maps, "run", run)
    result = await measure(cast(Robot, None), cut(SCANS, 2), [2, 1])
    assert asked == [("bench_1", 2, 1), ("bench_2", 2, 2)]
    assert [figure.workers for figure in result.figures] == [1, 2]
    assert result.figures[0].speedup == 1.0
    text = as_text(result)
    assert "machines  seconds  speed-up" in text
    assert "find_overlaps" in text
    assert as_data(result)["scans"] == result.scans
