"""Tests on recorded data: agreement of readers, and accuracy of maps of real buildings."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation.evaluation import alignment
from rce.mapping.evaluation.trials import Odometry, error_of, read_relations, run, with_odometry
from rce.mapping.evaluation.trials.endless import back_and_forth
from rce.mapping.files.outputs import trajectory_text
from rce.mapping.files.recordings import open_recording
from rce.mapping.mapper import Mapper, MapperSettings
from rce.mapping.particles.mapper import ParticleMapper
from rce.mapping.pose_graph.hypotheses import HypothesisMapper
from rce.mapping.pose_graph.mapper import GraphMapper

pytestmark = pytest.mark.slow  # maps recordings of whole buildings


def test_log_and_bag_of_a_run_have_the_same_scans(data: Path) -> None:
    log, bag = open_recording(data / "mit-csail.clf.gz"), open_recording(data / "bags" / "mit-csail")
    assert log.scans == bag.scans == 1988
    assert log.duration == pytest.approx(bag.duration, abs=1e-3)
    for ours, theirs in zip(log, bag, strict=True):
        assert f"{ours.stamp:.6f}" == f"{theirs.stamp:.6f}"
        np.testing.assert_array_equal(ours.ranges, theirs.ranges)
        assert ours.odometry == pytest.approx(theirs.odometry)
        assert (ours.angle_min, ours.range_max) == pytest.approx((theirs.angle_min, theirs.range_max))
        assert ours.angle_increment == pytest.approx(theirs.angle_increment)


def error_by_tool(mapper: Mapper, data: Path, directory: Path) -> tuple[float, float]:
    """Return the mean error of the relations of MIT CSAIL by the tool of the benchmark: metres, degrees."""
    trajectory = directory / "trajectory.txt"
    trajectory.write_bytes(trajectory_text(mapper.trajectory()))
    tool, relations = data / "tools" / "slam_metric.py", data / "mit-csail.relations"
    answer = subprocess.run(
        [sys.executable, tool, trajectory, relations, "--json"], capture_output=True, check=True, text=True
    )
    metric = json.loads(answer.stdout)
    assert metric["used"] == 1172
    return metric["trans_abs"][0], metric["rot_abs_deg"][0]


ODOMETRY = {
    "as recorded": Odometry(),
    "degraded odometry": Odometry(scale=1.1, noise=0.1, slip=1.0),
    "no odometry": Odometry(none=True),
}


@pytest.mark.parametrize("rounding", [0.0, 4e-8])
def test_pose_does_not_slip_along_a_corridor(data: Path, rounding: float) -> None:
    """A few points that belong to no wall pulled the pose along; rounding of the angle decided whether they did."""
    mapper = GraphMapper()
    for scan in list(open_recording(data / "mit-csail.clf.gz"))[1200:1610]:
        mapper.add(replace(scan, angle_min=scan.angle_min - rounding))
    trajectory = mapper.trajectory()
    error = error_of(trajectory, read_relations(data / "mit-csail.relations", trajectory[:, 0]))
    assert error.worst < 0.2


@pytest.mark.parametrize("odometry", ODOMETRY)
def test_graph_map_of_mit_csail_beats_other_systems(data: Path, tmp_path: Path, odometry: str) -> None:
    mapper = GraphMapper()
    for scan in with_odometry(open_recording(data / "mit-csail.clf.gz"), ODOMETRY[odometry]):
        mapper.add(scan)
    metres, degrees = error_by_tool(mapper, data, tmp_path)
    assert metres < 0.030
    assert degrees < 0.45


def test_particle_map_of_mit_csail_beats_other_systems(data: Path, tmp_path: Path) -> None:
    mapper, scans = ParticleMapper(), list(open_recording(data / "mit-csail.clf.gz"))
    for scan in scans:
        mapper.add(scan)
    metres, degrees = error_by_tool(mapper, data, tmp_path)
    assert metres < 0.042
    assert degrees < 1.5
    relations = read_relations(data / "mit-csail.relations", np.array([scan.stamp for scan in scans]))
    ours = error_of(mapper.trajectory(), relations)
    assert (ours.translation, math.degrees(ours.rotation)) == pytest.approx((metres, degrees), rel=1e-3)


@pytest.mark.parametrize(
    ("name", "odometry", "limit"),
    [
        ("aces", Odometry(1.03, 0.1), 0.2),
        ("infinite-corridor", Odometry(1.03, 0.1), 1.5),
        ("infinite-corridor", Odometry(1.1, 0.1, slip=1.0), 1.5),
    ],
    ids=["aces", "infinite corridor", "infinite corridor with wheels that are 10 % too small and slip"],
)
def test_large_loops_are_closed(data: Path, name: str, odometry: Odometry, limit: float) -> None:
    """The error is metres if a loop stays open, and tens of metres if one is closed wrongly."""
    scans = list(open_recording(data / "corrected" / f"{name}-corrected.log.gz"))
    mapper = GraphMapper()
    for scan in with_odometry(scans, odometry):
        mapper.add(scan)
    truth = np.array([scan.odometry for scan in scans])[:, :2]
    found = mapper.trajectory()[:, 1:3]
    assert np.hypot(*(alignment(found, truth).transform(found) - truth).T).mean() < limit


def test_loop_that_no_particle_closes_is_closed(data: Path) -> None:
    """The path is 2 m off where the robot comes back; without the graph along it the error is 0.45 m."""
    scans = list(open_recording(data / "corrected" / "infinite-corridor-corrected.log.gz"))[:560]
    few = MapperSettings(particles=10)
    assert run(lambda: ParticleMapper(few), scans, Odometry(1.03, 0.1)).errors["loop"].translation < 0.15


@pytest.mark.parametrize("name", ["aces", "orebro"])
def test_loops_are_closed_without_odometry(data: Path, name: str) -> None:
    """The logs have a scan a metre, and many steps fit at several places."""
    scans = list(open_recording(data / "corrected" / f"{name}-corrected.log.gz"))
    assert run(HypothesisMapper, scans, Odometry(none=True)).closed


def test_all_corrected_logs_are_read_completely(data: Path) -> None:
    for path in sorted((data / "corrected").glob("*.log.gz")):
        recording = open_recording(path)
        stamps = [scan.stamp for scan in recording]
        assert len(stamps) == recording.scans
        assert np.diff(stamps).min() > 0, path.name


def test_one_of_two_lidars_is_used(data: Path) -> None:
    bag = data / "bags" / "two-lidars.bag"
    assert len(list(open_recording(bag))) == open_recording(bag, "/front_scan").scans == 331
    rear = next(iter(open_recording(bag, "/rear_scan")))
    assert (len(rear.ranges), rear.odometry) == (726, None)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("version-1.2.bag", r"format 1\.2"),
        ("wrong-index.bag", "damaged or not indexed"),
        ("tf_example", "no laser scans"),
        ("nav2_turtlebot.mcap", "no laser scans"),
    ],
)
def test_bags_that_cannot_be_mapped_are_rejected(data: Path, name: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        open_recording(data / "bags" / name)


def test_corridor_driven_back_is_not_mapped_twice(data: Path) -> None:
    """On the way back the end of the corridor is not visible, and scans fit best where the last ones were.

    Without the wheels the robot would seem to stand still. No more is kept than on the way there.
    """
    there = list(open_recording(data / "mit-csail.clf.gz"))[990:1130]
    mapper = ParticleMapper(MapperSettings(particles=10))
    kept = []
    for number, scan in enumerate(back_and_forth(there, 2 * len(there) - 1), start=1):
        mapper.add(scan)
        if number in (len(there), 2 * len(there) - 1):
            tables = mapper._filter.maps.tables
            kept.append((int((tables[mapper._filter.best] >= 0).sum()), len(list(mapper._graph.sweeps()))))
    places = mapper.trajectory()[:, 1:3]
    off = np.hypot(*(places[len(there) - 1 :] - places[len(there) - 1 :: -1]).T)
    assert off.mean() < 0.12
    assert off.max() < 1.0
    (tiles, sweeps), (tiles_later, sweeps_later) = kept
    assert tiles_later <= 1.05 * tiles
    assert sweeps_later <= 1.1 * sweeps
