"""Scans and odometry of one robot, and the answers that it gets."""

from __future__ import annotations

import math
from array import array
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rce.mapping.geometry import Pose
from rce.mapping.mapper import Estimate
from rce.mapping.scans import Scan
from tests.support.containers.recording_node import RecordingNode

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from tests.support.containers.mapper_robot import transform

FRAMES = {"map_frame": "map", "odom_frame": "odom", "base_frame": "base_link"}
OPTIONS = {"odom_timeout": 0.5, "use_odometry": True, "odometry_from_tf": False}


class Bench:
    """A track on a node that records; its mapper moves one metre with each scan, and refuses old ones."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, prefix: str = "", **options: object) -> None:
        from rce_mapping import paired_scans, track

        self.now = 100.0
        self.mapped: list[Scan] = []
        monkeypatch.setattr(paired_scans, "time", SimpleNamespace(monotonic=lambda: self.now))
        self.node = RecordingNode(**FRAMES, **OPTIONS | options)
        self.track: Any = track.Track(self.node, self._add, prefix)

    def _add(self, scan: Scan) -> Estimate:
        accepted = not self.mapped or scan.stamp > self.mapped[-1].stamp
        if accepted:
            self.mapped.append(scan)
        return Estimate(scan.stamp, Pose(len(self.mapped), 0.0, 0.0), np.eye(3), matched=True, accepted=accepted)

    def scan(self, second: int, frame: str = "base_link") -> None:
        message = LaserScan(ranges=array("f", [1.0]))
        message.header.stamp, message.header.frame_id = Time(sec=second), frame
        self.node.receive("scan", message)

    def odometry(self, second: int, x: float) -> None:
        message = Odometry()
        message.header.stamp, message.pose.pose.position.x = Time(sec=second), x
        self.node.receive("odom", message)

    def after(self, seconds: float) -> None:
        """Let time pass, and the check for overdue scans run."""
        self.now += seconds
        (check,) = self.node.timers
        check()

    def answers(self) -> list[tuple[int, float]]:
        """Return stamp and x of each answer."""
        return [(pose.header.stamp.sec, pose.pose.pose.position.x) for pose in self.node.sent("pose")]


@pytest.fixture
def bench(interfaces: None, monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_scan_waits_for_its_odometry(bench: Bench) -> None:
    bench.scan(1)
    bench.after(0.4)
    assert bench.answers() == []
    bench.odometry(1, 5.0)
    assert bench.answers() == [(1, 1.0)]
    assert bench.mapped[0].odometry == (5.0, 0.0, 0.0)


def test_overdue_scan_is_mapped_and_the_next_ones_do_not_wait(bench: Bench) -> None:
    bench.scan(1)
    bench.after(0.6)
    assert bench.answers() == [(1, 1.0)]
    assert bench.mapped[0].odometry is None
    bench.scan(2)
    assert bench.answers() == [(1, 1.0), (2, 2.0)]


def test_scans_wait_again_when_there_is_odometry_again(bench: Bench) -> None:
    bench.scan(1)
    bench.after(0.6)
    bench.odometry(2, 1.0)
    bench.scan(3)
    assert len(bench.answers()) == 1
    bench.odometry(3, 2.0)
    assert len(bench.answers()) == 2


def test_scans_do_not_wait_if_odometry_is_not_used(interfaces: None, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, use_odometry=False)
    assert "odom" not in bench.node.subscriptions
    bench.scan(1)
    assert bench.answers() == [(1, 1.0)]


def test_late_scan_is_answered_but_has_no_stamp_in_the_path(bench: Bench) -> None:
    for second in (2, 3, 2):
        bench.scan(second)
    bench.after(0.6)
    assert [second for second, _ in bench.answers()] == [2, 3, 2]
    assert [stamp.sec for stamp in bench.track.stamps] == [2, 3]


def test_paused_track_answers_with_the_last_pose(bench: Bench) -> None:
    bench.scan(1)
    bench.after(0.6)
    bench.track.paused = True
    bench.scan(2)
    assert bench.answers() == [(1, 1.0), (2, 1.0)]
    assert len(bench.mapped) == len(bench.track.stamps) == 1
    bench.track.paused = False
    bench.scan(3)
    assert bench.answers()[-1] == (3, 2.0)


def test_restart_answers_the_scans_that_wait(bench: Bench) -> None:
    """A sender that limits its unanswered scans would otherwise wait for ever."""
    bench.scan(1)
    bench.scan(2)
    bench.track.restart(np.empty((0, 4)))
    assert bench.answers() == [(1, 0.0), (2, 0.0)]
    assert (bench.mapped, bench.track.stamps) == ([], [])
    bench.scan(3)
    bench.odometry(3, 1.0)
    assert bench.answers()[2:] == [(3, 1.0)]


def test_pose_of_the_discarded_map_is_forgotten(bench: Bench) -> None:
    bench.scan(1)
    bench.after(0.6)
    bench.track.restart(np.empty((0, 4)))
    bench.track.paused = True
    bench.scan(2)
    assert bench.answers() == [(1, 1.0), (2, 0.0)]


def test_continued_session_has_its_stamps_and_last_pose(bench: Bench) -> None:
    bench.track.restart(np.array([[1.0, 4.0, 0.0, 0.0], [2.5, 6.0, 0.0, 0.0]]))
    assert bench.track.stamps == [Time(sec=1), Time(sec=2, nanosec=500_000_000)]
    bench.track.paused = True
    bench.scan(3)
    bench.after(0.6)
    assert bench.answers() == [(3, 6.0)]


def test_mapper_sees_the_laser_and_the_answer_is_the_robot(bench: Bench) -> None:
    """The laser is half a metre in front of the axle, and looks backwards."""
    fixed = transform("base_link", "laser", 0.5, math.pi, Time())
    bench.node.receive("/tf_static", SimpleNamespace(transforms=[fixed]))
    bench.scan(1, "laser")
    bench.odometry(1, 5.0)
    assert bench.mapped[0].odometry == pytest.approx((5.5, 0.0, -math.pi))
    ((stamp, x),) = bench.answers()
    assert (stamp, x) == (1, pytest.approx(1.5)), "the mapper says 1.0 for the laser, which looks along x"
    assert bench.track.in_laser_frame(Pose(2.0, 0.0, 0.0)) == pytest.approx((2.5, 0.0, -math.pi))


def test_path_is_that_of_the_robot(bench: Bench) -> None:
    fixed = transform("base_link", "laser", 0.5, 0.0, Time())
    bench.node.receive("/tf_static", SimpleNamespace(transforms=[fixed]))
    bench.scan(1, "laser")
    bench.odometry(1, 0.0)
    bench.track.publish_path(np.array([[1.0, 3.0, 0.0, 0.0]]))
    (path,) = bench.node.sent("path")
    assert path.poses[0].pose.position.x == pytest.approx(2.5)
    assert path.poses[0].header.stamp == Time(sec=1)


def test_topics_and_frames_of_a_member_of_a_team(interfaces: None, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(monkeypatch, "one/")
    assert set(bench.node.subscriptions) == {"one/scan", "one/odom", "/tf_static"}
    assert set(bench.node.publishers) == {"one/pose", "one/path", "/tf"}
    message = LaserScan(ranges=array("f", [1.0]))
    bench.node.receive("one/scan", message)
    bench.after(0.6)
    (sent,) = bench.node.sent("/tf")[0].transforms
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "one/base_link")
