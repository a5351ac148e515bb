"""Robustness of both mappers on a part of a real log."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rce.mapping.evaluation.trials import Odometry, error_of, relations_of, run, with_odometry
from rce.mapping.files.recordings import open_recording
from rce.mapping.geometry import Pose
from rce.mapping.mapper import MapperSettings
from rce.mapping.mappers import MAPPERS
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.scans import Scan

pytestmark = pytest.mark.slow  # maps the simulation several times

SETTINGS = MapperSettings(particles=10)
SCANS = 150


@pytest.fixture(scope="module")
def piece(data: Path) -> list[Scan]:
    """First 30 s of MIT CSAIL, with the poses of its map (errors below 3 cm) as odometry."""
    mapper, scans = GraphMapper(), list(open_recording(data / "mit-csail.clf.gz"))[:SCANS]
    for scan in scans:
        mapper.add(scan)
    return [
        dataclasses.replace(scan, odometry=Pose(*row))
        for scan, row in zip(scans, mapper.trajectory()[:, 1:], strict=True)
    ]


def beams(scan: Scan, which: slice) -> Scan:
    """Return a scan with a part of the beams."""
    first, step = which.start or 0, which.step or 1
    return dataclasses.replace(
        scan,
        ranges=np.ascontiguousarray(scan.ranges[which]),
        angle_min=scan.angle_min + first * scan.angle_increment,
        angle_increment=step * scan.angle_increment,
    )


def with_invalid_ranges(scan: Scan) -> Scan:
    """Return a scan in which a third of the beams have no echo, in all notations of drivers."""
    ranges = scan.ranges.copy()
    for i, value in enumerate((np.nan, np.inf, -np.inf, 0.0, -1.0, 81.91, scan.range_max)):
        ranges[i::21] = value
    return dataclasses.replace(scan, ranges=ranges)


def noisy(scan: Scan) -> Scan:
    """Return a scan whose ranges have 3 cm of noise."""
    noise = np.random.default_rng(round(scan.stamp * 1e3) % 2**32).normal(0.0, 0.03, len(scan.ranges))
    return dataclasses.replace(scan, ranges=(scan.ranges + noise).astype(np.float32))


def elsewhere(scan: Scan) -> Scan:
    """Return a scan whose odometry frame is shifted far away and rotated."""
    assert scan.odometry
    return dataclasses.replace(scan, odometry=Pose(1e4, -3e3, 2.5) @ scan.odometry)


CHANGES: dict[str, Callable[[Scan], Scan]] = {
    "90 degrees": lambda scan: beams(scan, slice(90, 271)),
    "73 beams": lambda scan: beams(scan, slice(0, None, 5)),
    "no returns": with_invalid_ranges,
    "noise": noisy,
    "odometry from elsewhere": elsewhere,
}
DEGRADED = {
    "scale": Odometry(scale=1.1),
    "noise": Odometry(scale=1.05, noise=0.3),
    "slip": Odometry(slip=1.0, slip_every=50),
    "none": Odometry(none=True),
}


@pytest.mark.parametrize("name", MAPPERS)
@pytest.mark.parametrize("change", CHANGES)
def test_mapping_works_with_any_laser_and_start(piece: list[Scan], name: str, change: str) -> None:
    given = [CHANGES[change](scan) for scan in with_odometry(piece, Odometry(scale=1.02, noise=0.05))]
    assert error(name, piece, given) < 0.1


@pytest.mark.parametrize("name", MAPPERS)
@pytest.mark.parametrize("degradation", DEGRADED)
def test_mapping_works_with_any_odometry(piece: list[Scan], name: str, degradation: str) -> None:
    assert error(name, piece, list(with_odometry(piece, DEGRADED[degradation]))) < 0.1


@pytest.mark.parametrize("name", MAPPERS)
def test_late_and_duplicate_scans_do_not_change_the_map(piece: list[Scan], name: str) -> None:
    """Each scan comes twice, and from time to time an old one again."""
    mixed = [twice for scan in piece[:100] for twice in (scan, scan)]
    for i in range(50, len(mixed), 40):
        mixed.insert(i, mixed[i - 30])
    plain, mapper = MAPPERS[name](SETTINGS), MAPPERS[name](SETTINGS)
    for scan in piece[:100]:
        plain.add(scan)
    taken = sum(mapper.add(scan).accepted for scan in mixed)
    assert taken == 100
    np.testing.assert_array_equal(mapper.trajectory(), plain.trajectory())
    np.testing.assert_array_equal(mapper.grid().cells, plain.grid().cells)


def error(name: str, truth: list[Scan], given: list[Scan]) -> float:
    """Return the mean error of poses 2 m of way apart, metres."""
    poses = np.array([(scan.stamp, *scan.odometry) for scan in truth if scan.odometry])
    trial = run(lambda: MAPPERS[name](SETTINGS), given, relations={"near": relations_of(poses)["near"]})
    assert len(trial.trajectory) == len(truth)
    assert error_of(poses, relations_of(poses)["near"]).translation == 0.0
    return trial.errors["near"].translation


@pytest.mark.parametrize(("log", "scans"), [("belgioioso", 100), ("csail", 90)])
def test_sparse_scans_are_mapped_without_odometry(data: Path, log: str, scans: int) -> None:
    """Steps of a metre or 40 degrees between scans, sometimes 65, without any prediction."""
    piece = list(open_recording(data / "corrected" / f"{log}-corrected.log.gz"))[:scans]
    trial = run(GraphMapper, piece, Odometry(none=True))
    assert trial.errors["near"].translation < 0.1
    assert math.degrees(trial.errors["near"].rotation) < 2.0
