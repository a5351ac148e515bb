"""What both mappers do alike with scans that are no good."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from rce.mapping.geometry import Pose
from rce.mapping.mapper import Mapper
from rce.mapping.mappers import MAPPERS
from rce.mapping.simulation import Simulation

STEP = Pose(0.1, 0.0, 0.05)


@pytest.fixture(params=MAPPERS)
def mapper(request: pytest.FixtureRequest) -> Mapper:
    return MAPPERS[request.param]()


@pytest.mark.parametrize("ranges", [[], [np.nan] * 360, [np.inf] * 360], ids=["empty", "nan", "inf"])
def test_an_unusable_scan_moves_by_odometry(mapper: Mapper, simulation: Simulation, ranges: list[float]) -> None:
    for scan in simulation.records[:20]:
        before = mapper.add(scan)
    assert scan.odometry
    blind = dataclasses.replace(
        scan, stamp=scan.stamp + 0.1, ranges=np.array(ranges, np.float32), odometry=scan.odometry @ STEP
    )
    estimate = mapper.add(blind)
    assert not estimate.matched
    assert estimate.pose == pytest.approx(before.pose @ STEP)
    assert len(mapper.trajectory()) == 21


def test_scans_that_come_late_or_twice_are_answered_and_dropped(mapper: Mapper, simulation: Simulation) -> None:
    scans = simulation.records[:30]
    for scan in scans:
        mapper.add(scan)
    before = mapper.trajectory()
    mapper.add(scans[-1])
    late = mapper.add(scans[10])
    assert (late.taken, late.matched, late.stamp) == (False, False, scans[10].stamp)
    assert late.pose == pytest.approx(tuple(before[10, 1:]))
    np.testing.assert_array_equal(mapper.trajectory(), before)


def test_before_the_first_scan_there_is_an_empty_map(mapper: Mapper) -> None:
    assert mapper.trajectory().shape == (0, 4)
    assert mapper.grid().cells.max() == -1
