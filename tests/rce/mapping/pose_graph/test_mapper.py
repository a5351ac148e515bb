from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation, evaluate
from rce.mapping.geometry import Pose
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.scans import Scan


def mapped(scans: Iterable[Scan]) -> GraphMapper:
    mapper = GraphMapper()
    for scan in scans:
        mapper.add(scan)
    return mapper


def test_map_of_simulation_is_accurate(simulation: Simulation) -> None:
    mapper = mapped(simulation)
    accuracy = evaluate(mapper.grid(), mapper.trajectory(), simulation)
    assert accuracy.translation < 0.03
    assert accuracy.rotation < math.radians(0.3)
    assert accuracy.walls_found > 0.95
    assert accuracy.walls_true > 0.98


def test_odometry_is_optional(simulation: Simulation) -> None:
    mapper = mapped(dataclasses.replace(scan, odometry=None) for scan in simulation)
    assert evaluate(mapper.grid(), mapper.trajectory(), simulation).translation < 0.03


def test_half_the_field_of_view_is_enough(simulation: Simulation) -> None:
    front = slice(90, 270)
    mapper = mapped(
        dataclasses.replace(scan, ranges=scan.ranges[front], angle_min=scan.angle_min + 90 * scan.angle_increment)
        for scan in simulation.records[:300]
    )
    part = dataclasses.replace(simulation, records=simulation.records[:300], truth=simulation.truth[:300])
    assert evaluate(mapper.grid(), mapper.trajectory(), part).translation < 0.05


@pytest.mark.slow
def test_memory_grows_with_the_building_and_not_with_time(simulation: Simulation) -> None:
    """The robot drives forward, and back on the same path."""
    scans = simulation.records
    back = [dataclasses.replace(scan, stamp=2 * scans[-1].stamp - scan.stamp) for scan in scans[-2::-1]]
    mapper = mapped(scans)
    before = memory(mapper)
    for scan in back:
        mapper.add(scan)
    assert memory(mapper) <= 1.05 * before
    there, again = mapper.trajectory()[: len(scans)], mapper.trajectory()[len(scans) - 1 :][::-1]
    assert np.hypot(*(there - again)[:, 1:3].T).mean() < 0.02


def memory(mapper: GraphMapper) -> int:
    """Return the bytes of all kept scans."""
    return sum(sweep.points.nbytes for node in mapper._graph.nodes.values() for sweep in node.sweeps)


@pytest.mark.parametrize("far", [0.3, 1.0])
def test_slip_of_the_wheels_is_corrected(simulation: Simulation, far: float) -> None:
    scans = list(simulation.records[:200])
    for i in range(100, 200):
        odometry = scans[i].odometry
        assert odometry
        scans[i] = dataclasses.replace(scans[i], odometry=Pose(far, -far / 2, 0.2) @ odometry)
    part = dataclasses.replace(simulation, records=scans, truth=simulation.truth[:200])
    mapper = mapped(scans)
    assert evaluate(mapper.grid(), mapper.trajectory(), part).translation < 0.03


def test_same_scans_give_the_same_map(simulation: Simulation) -> None:
    first, second = mapped(simulation.records[:150]), mapped(simulation.records[:150])
    np.testing.assert_array_equal(first.trajectory(), second.trajectory())
    np.testing.assert_array_equal(first.grid().cells, second.grid().cells)


def test_invalid_ranges_are_ignored(simulation: Simulation) -> None:
    bad = (np.nan, np.inf, -np.inf, 0.0, -1.0, 81.91, 12.0)
    scans = []
    for scan in simulation.records[:150]:
        ranges = scan.ranges.copy()
        for i, value in enumerate(bad):
            ranges[i::20] = value
        scans.append(dataclasses.replace(scan, ranges=ranges))
    part = dataclasses.replace(simulation, records=scans, truth=simulation.truth[:150])
    mapper = mapped(scans)
    assert evaluate(mapper.grid(), mapper.trajectory(), part).translation < 0.03


@pytest.mark.parametrize("odometry", [Pose(1e9, 0.0, 0.0), Pose(math.nan, 0.0, 0.0), None], ids=["reset", "nan", "gap"])
def test_invalid_odometry_is_tolerated(simulation: Simulation, odometry: Pose | None) -> None:
    scans = list(simulation.records[:60])
    scans[30] = dataclasses.replace(scans[30], odometry=odometry)
    part = dataclasses.replace(simulation, records=scans, truth=simulation.truth[:60])
    mapper = mapped(scans)
    assert evaluate(mapper.grid(), mapper.trajectory(), part).translation < 0.03


def sparse(simulation: Simulation) -> list[Scan]:
    """Return every fifth scan, a minute apart and without odometry: nothing predicts the motion."""
    return [
        dataclasses.replace(scan, stamp=60.0 * number, odometry=None)
        for number, scan in enumerate(simulation.records[:150:5])
    ]


@pytest.mark.slow
def test_scan_that_contradicts_the_map_is_not_kept(simulation: Simulation) -> None:
    """For two scans the laser sees nothing but rain."""
    scans = sparse(simulation)
    mapper, undisturbed = mapped(scans[:20]), mapped(scans)
    before = mapper.grid().cells.copy()
    for scan in scans[20:22]:
        rain = np.random.default_rng(0).uniform(0.3, 3.0, len(scan.ranges)).astype(np.float32)
        answer = mapper.add(dataclasses.replace(scan, ranges=rain))
        assert (answer.matched, answer.accepted) == (False, True)
    np.testing.assert_array_equal(mapper.grid().cells, before)
    for scan in scans[22:]:
        assert mapper.add(scan).matched
    off = mapper.trajectory()[-1, 1:3] - undisturbed.trajectory()[-1, 1:3]
    assert np.hypot(*off) < 0.05


def test_copy_continues_exactly_and_by_itself(simulation: Simulation) -> None:
    scans = sparse(simulation)
    mapper = mapped(scans[:15])
    before, copied = mapper.trajectory(), mapper.copy()
    found = [copied.add(scan).pose for scan in scans[15:]]
    np.testing.assert_array_equal(mapper.trajectory(), before)
    assert found == [mapper.add(scan).pose for scan in scans[15:]]
    np.testing.assert_array_equal(copied.grid().cells, mapper.grid().cells)


def test_scan_with_invalid_angles_is_not_matched(simulation: Simulation) -> None:
    mapper = mapped(simulation.records[:5])
    assert not mapper.add(dataclasses.replace(simulation.records[5], angle_increment=math.nan)).matched
