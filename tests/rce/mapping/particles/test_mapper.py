from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.mapping.evaluation.simulation import Simulation, evaluate
from rce.mapping.geometry import Points, Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import MapperSettings
from rce.mapping.particles.mapper import ParticleMapper
from rce.mapping.scans import Scan

FEW = 10  # particles, for tests in which the accuracy does not matter
OFFSET = np.array([20.0, -10.0])  # metres
Array = NDArray[np.float64]


def mapped(scans: Iterable[Scan], **settings: int) -> ParticleMapper:
    mapper = ParticleMapper(MapperSettings(**settings))
    for scan in scans:
        mapper.add(scan)
    return mapper


def part_of(simulation: Simulation, count: int) -> Simulation:
    return dataclasses.replace(simulation, records=simulation.records[:count], truth=simulation.truth[:count])


@pytest.mark.slow
def test_map_of_simulation_is_accurate(simulation: Simulation) -> None:
    mapper = mapped(simulation)
    accuracy = evaluate(mapper.grid(), mapper.trajectory(), simulation)
    assert accuracy.translation < 0.05
    assert accuracy.rotation < math.radians(0.5)
    assert accuracy.walls_found > 0.95
    assert accuracy.walls_true > 0.97


@pytest.mark.slow
def test_map_does_not_depend_on_the_number_of_cores(simulation: Simulation) -> None:
    scans = simulation.records[:300]
    first, second = mapped(scans, particles=FEW, cores=1), mapped(scans, particles=FEW, cores=3)
    other = mapped(scans, particles=FEW, seed=1)
    np.testing.assert_array_equal(first.trajectory(), second.trajectory())
    np.testing.assert_array_equal(first.grid().cells, second.grid().cells)
    assert not np.array_equal(first.trajectory(), other.trajectory())


def test_one_particle_is_enough_for_a_map(simulation: Simulation) -> None:
    part = part_of(simulation, 200)
    mapper = mapped(part, particles=1)
    assert evaluate(mapper.grid(), mapper.trajectory(), part).translation < 0.05


@pytest.mark.slow
def test_missing_odometry_and_slip_are_tolerated(simulation: Simulation) -> None:
    part = part_of(simulation, 300)
    without = [dataclasses.replace(scan, odometry=None) for scan in part]
    slipped = list(part)
    for i in range(150, 300):
        odometry = slipped[i].odometry
        assert odometry
        slipped[i] = dataclasses.replace(slipped[i], odometry=Pose(1.0, -0.5, 0.2) @ odometry)
    for scans in (without, slipped):
        mapper = mapped(scans)
        assert evaluate(mapper.grid(), mapper.trajectory(), part).translation < 0.05


def test_particles_continue_from_a_corrected_path(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    scans = simulation.records[:120]
    mapper = mapped(scans[:100], particles=FEW)
    before, drawn = mapper.trajectory(), mapper.grid()
    extend = mapper._graph.extend
    corrected: list[Array] = []

    def correct(path: Array, points: Points | None, covariance: Array) -> Array | None:
        extend(path, points, covariance)
        if not corrected:
            corrected.append(moved(path))
            mapper._graph.follow(corrected[0])
            return corrected[0]
        return None

    monkeypatch.setattr(mapper._graph, "extend", correct)
    for scan in scans[100:]:
        mapper.add(scan)
    after = mapper.trajectory()
    assert len(after) == len(scans)
    np.testing.assert_allclose(after[:100, 1:3], before[:, 1:3] + OFFSET, atol=0.2)
    steps = np.hypot(*np.diff(after[:, 1:3], axis=0).T)
    assert steps.max() < 0.3, "the robot goes on from there"
    np.testing.assert_allclose(middle(mapper.grid()), middle(drawn) + OFFSET, atol=0.5)


def middle(grid: OccupancyGrid) -> Array:
    """Return the mean (2,) of all occupied cells, metres, map frame."""
    return np.asarray(grid.centres(grid.cells > 50).mean(axis=0), np.float64)


def moved(path: Array) -> Array:
    """Return the path moved by OFFSET."""
    shifted: Array = path + np.array([*OFFSET, 0.0])
    return shifted


@pytest.mark.slow
def test_grid_does_not_depend_on_the_number_of_calls(simulation: Simulation) -> None:
    """The grid is drawn incrementally, and rendered anew when another particle takes over."""
    scans = simulation.records[:300]
    often = mapped([], particles=FEW)
    for i, scan in enumerate(scans):
        often.add(scan)
        if i % 20 == 0:
            often.grid()
    np.testing.assert_array_equal(often.grid().cells, mapped(scans, particles=FEW).grid().cells)


@pytest.mark.slow
def test_memory_grows_with_the_building_and_not_with_time(simulation: Simulation) -> None:
    scans = simulation.records[:400]
    back = [dataclasses.replace(scan, stamp=2 * scans[-1].stamp - scan.stamp) for scan in scans[-2::-1]]
    again = [dataclasses.replace(scan, stamp=scan.stamp + 100.0) for scan in scans[1:]]
    mapper = mapped([*scans, *back], particles=FEW)
    before = memory(mapper)
    for scan in again:
        mapper.add(scan)
    assert memory(mapper) <= 1.15 * before


def memory(mapper: ParticleMapper) -> float:
    """Return the bytes of all kept scans and of all tiles."""
    sweeps = sum(sweep.points.nbytes for _, sweep in mapper._graph.sweeps())
    return float(sweeps + mapper._filter.maps.used * mapper._filter.maps.tiles[0].nbytes)
