"""On recorded data: that readers agree, and how good the map of a real building is."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.graph_mapper import GraphMapper
from rce.mapping.outputs import trajectory_text
from rce.mapping.recordings import open_recording


def test_the_log_and_the_bag_of_a_run_give_the_same_scans(data: Path) -> None:
    log, bag = open_recording(data / "mit-csail.clf.gz"), open_recording(data / "bags" / "mit-csail")
    assert log.scans == bag.scans == 1988
    assert log.duration == pytest.approx(bag.duration, abs=1e-3)
    for ours, theirs in zip(log, bag, strict=True):
        assert f"{ours.stamp:.6f}" == f"{theirs.stamp:.6f}"
        np.testing.assert_array_equal(ours.ranges, theirs.ranges)
        assert ours.odometry == pytest.approx(theirs.odometry)
        assert (ours.angle_min, ours.range_max) == pytest.approx((theirs.angle_min, theirs.range_max))
        assert ours.angle_increment == pytest.approx(theirs.angle_increment)


def test_the_map_of_mit_csail_is_as_good_as_those_of_others(data: Path, tmp_path: Path) -> None:
    mapper = GraphMapper()
    for scan in open_recording(data / "mit-csail.clf.gz"):
        mapper.add(scan)
    trajectory = tmp_path / "trajectory.txt"
    trajectory.write_bytes(trajectory_text(mapper.trajectory()))
    tool, relations = data / "tools" / "slam_metric.py", data / "mit-csail.relations"
    answer = subprocess.run(
        [sys.executable, tool, trajectory, relations, "--json"], capture_output=True, check=True, text=True
    )
    metric = json.loads(answer.stdout)
    assert metric["used"] == 1172
    assert metric["trans_abs"][0] < 0.030
    assert metric["rot_abs_deg"][0] < 0.45


def test_every_corrected_log_is_read_whole(data: Path) -> None:
    for path in sorted((data / "corrected").glob("*.log.gz")):
        recording = open_recording(path)
        stamps = [scan.stamp for scan in recording]
        assert len(stamps) == recording.scans
        assert np.diff(stamps).min() > 0, path.name


def test_of_two_lidars_one_is_taken(data: Path) -> None:
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
def test_bags_that_cannot_be_mapped_are_refused(data: Path, name: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        open_recording(data / "bags" / name)
