"""Tests of the ROS 2 node `mapper`, with the node of a robot in the same process."""

# ruff: noqa: E402  (ROS is imported only if it is installed)

from __future__ import annotations

import importlib
import math
import sys
import time
from array import array
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from provisioning import typesupport
from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.scans import Scan
from tests.support.domains import domain
from tests.support.paths import ROOT
from tests.support.spin import spin_until

rclpy = pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetMap
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import LaserScan
from std_msgs.msg import String

PACKAGE = ROOT / "containers" / "nodes" / "rce_mapping"
UPDATE_PAUSE = 0.3  # seconds without new scans, in which several updates are due
RESEND_AFTER = 0.2  # seconds after which a best-effort message without an answer is sent again


def stamp_of(seconds: float) -> Time:
    nanoseconds = round(seconds * 1e9)
    return Time(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


class Robot:
    """A mapper node and the node of a robot, both on one executor."""

    def __init__(self, parameters: list[Any]) -> None:
        from rce_mapping import node
        from rce_mapping.inputs import LOSSLESS
        from rce_mapping.map_output import LATCHED

        self.mapper = node.MapperNode()
        self.node = rclpy.create_node("robot")
        self.poses: list[PoseWithCovarianceStamped] = []
        self.maps: list[OccupancyGrid] = []
        self.paths: list[PathMessage] = []
        self.node.create_subscription(PoseWithCovarianceStamped, "pose", self.poses.append, LOSSLESS)
        self.node.create_subscription(OccupancyGrid, "map", self.maps.append, LATCHED)
        self.node.create_subscription(PathMessage, "path", self.paths.append, LATCHED)
        self.scans = self.node.create_publisher(LaserScan, "scan", LOSSLESS)
        self.odometry = self.node.create_publisher(Odometry, "odom", LOSSLESS)
        self.client = self.node.create_client(GetMap, "dynamic_map")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.mapper)
        self.executor.add_node(self.node)
        self.mapper.set_parameters(parameters)
        self.until(lambda: bool(self.maps) and self.scans.get_subscription_count() == 1)
        # Poses are not latched: an answer to a scan is lost unless the mapper has discovered the subscription.
        self.until(lambda: self.mapper.track._pose_out.get_subscription_count() == 1)
        self.until(self.client.service_is_ready)

    def until(self, condition: Callable[[], bool]) -> None:
        spin_until(self.executor, condition)

    def send_scan(self, scan: Scan, frame: str = "base_link") -> None:
        message = LaserScan(angle_min=scan.angle_min, angle_increment=scan.angle_increment, range_max=scan.range_max)
        message.header.stamp, message.header.frame_id = stamp_of(scan.stamp), frame
        message.ranges = array("f", scan.ranges.tobytes())
        self.scans.publish(message)

    def send_odometry(self, scan: Scan) -> None:
        self.until(lambda: self.odometry.get_subscription_count() == 1)
        assert scan.odometry
        message = Odometry()
        message.header.stamp = stamp_of(scan.stamp)
        message.pose.pose.position.x, message.pose.pose.position.y, theta = scan.odometry
        message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(theta / 2), math.cos(theta / 2)
        self.odometry.publish(message)

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.mapper.destroy_node()


@pytest.fixture
def parameters(request: pytest.FixtureRequest) -> list[str]:
    return getattr(request, "param", [])


@pytest.fixture
def robot(monkeypatch: pytest.MonkeyPatch, parameters: list[str]) -> Iterator[Robot]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(
        sys, "path", [str(PACKAGE), str(typesupport.build(typesupport.shipped()).prefix / "python"), *sys.path]
    )
    words = [word for each in parameters for word in ("-p", each)]
    rclpy.init(args=["--ros-args", *words], domain_id=domain("mapping"))
    robot = Robot([Parameter("map_update_interval", value=3600.0)])
    yield robot
    robot.close()
    rclpy.shutdown()


def test_each_scan_is_answered_with_its_stamp_and_mapped(robot: Robot, simulation: Simulation) -> None:
    assert (robot.maps[0].info.width, list(robot.maps[0].data)) == (1, [-1]), (
        "the first, empty map means that the node is ready"
    )
    sent = simulation.records[:40]
    for i, scan in enumerate(sent):
        for send in (robot.send_scan, robot.send_odometry)[:: 1 if i % 2 else -1]:
            send(scan)
    robot.until(lambda: len(robot.poses) == len(sent))
    assert [pose.header.stamp for pose in robot.poses] == [stamp_of(scan.stamp) for scan in sent]
    assert {pose.header.frame_id for pose in robot.poses} == {"map"}
    covariance = np.array(robot.poses[-1].pose.covariance).reshape(6, 6)
    assert np.diag(covariance)[[0, 1, 5]].min() > 0

    answer = robot.client.call_async(GetMap.Request())
    robot.until(lambda: answer.done() and len(robot.maps) == 2 and bool(robot.paths[-1].poses))
    assert answer.result().map == robot.maps[-1]
    assert robot.maps[-1].info.width * robot.maps[-1].info.height == len(robot.maps[-1].data)
    assert max(robot.maps[-1].data) > 65
    assert [pose.header.stamp for pose in robot.paths[-1].poses] == [stamp_of(scan.stamp) for scan in sent]
    last, answered = robot.paths[-1].poses[-1].pose, robot.poses[-1].pose.pose
    assert (last.position.x, last.position.y) == pytest.approx((answered.position.x, answered.position.y), abs=1e-9)


def test_scans_without_odometry_and_unusable_scans_are_answered(robot: Robot, simulation: Simulation) -> None:
    sent = [*simulation.records[:3], Scan(1.8e9, np.empty(0, np.float32), 0.0, 0.0, 0.0), simulation.records[3]]
    for scan in sent:
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == len(sent))
    assert [pose.header.stamp for pose in robot.poses] == [stamp_of(scan.stamp) for scan in sent]


def test_duplicate_scan_is_answered_but_not_mapped(robot: Robot, simulation: Simulation) -> None:
    for scan in (*simulation.records[:3], simulation.records[1]):
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == 4)
    answer = robot.client.call_async(GetMap.Request())
    robot.until(lambda: answer.done() and bool(robot.paths[-1].poses))
    assert len(robot.paths[-1].poses) == 3


def call(robot: Robot, package: str, kind: str, name: str, /, **fields: Any) -> Any:
    service = getattr(importlib.import_module(f"{package}.srv"), kind)
    client = robot.node.create_client(service, name)
    robot.until(client.service_is_ready)
    answer = client.call_async(service.Request(**fields))
    robot.until(answer.done)
    return answer.result()


def test_pause_reset_and_save(robot: Robot, simulation: Simulation, tmp_path: Path) -> None:
    for scan in simulation.records[:20]:
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == 20)
    assert (
        call(robot, "slam_toolbox", "SaveMap", "slam_toolbox/save_map", name=String(data=f"{tmp_path}/one")).result == 0
    )
    assert call(robot, "nav2_msgs", "SaveMap", "map_saver/save_map", map_url=f"{tmp_path}/two.yaml").result
    assert (tmp_path / "one.pgm").read_bytes() == (tmp_path / "two.pgm").read_bytes()
    assert "image: two.pgm" in (tmp_path / "two.yaml").read_text()
    assert not call(robot, "nav2_msgs", "SaveMap", "map_saver/save_map", map_url="/proc/no/map").result
    assert call(robot, "slam_toolbox", "Pause", "slam_toolbox/pause_new_measurements").status
    for scan in simulation.records[20:23]:
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == 23)
    assert {pose.pose.pose.position.x for pose in robot.poses[20:]} == {robot.poses[19].pose.pose.position.x}
    assert call(robot, "slam_toolbox", "Reset", "slam_toolbox/reset").result == 0
    robot.send_scan(simulation.records[30])
    robot.until(lambda: len(robot.poses) == 24)
    assert robot.poses[-1].pose.pose.position.x == 0.0


def test_saved_session_is_continued(robot: Robot, simulation: Simulation, tmp_path: Path) -> None:
    file = str(tmp_path / "session.npz")
    for scan in simulation.records[:20]:
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == 20)
    assert call(robot, "slam_toolbox", "SerializePoseGraph", "slam_toolbox/serialize_map", filename=file).result == 0
    robot.send_scan(simulation.records[20])
    robot.until(lambda: len(robot.poses) == 21)
    call(robot, "slam_toolbox", "Reset", "slam_toolbox/reset")
    call(robot, "slam_toolbox", "DeserializePoseGraph", "slam_toolbox/deserialize_map", filename=file)
    robot.send_scan(simulation.records[20])
    robot.until(lambda: len(robot.poses) == 22)
    assert robot.poses[21].pose.pose == robot.poses[20].pose.pose
    robot.until(lambda: len(robot.paths[-1].poses) >= 20)
    answer = call(robot, "slam_toolbox", "SerializePoseGraph", "slam_toolbox/serialize_map", filename="/proc/no/file")
    assert answer.result == 255


def test_robot_is_localised_in_loaded_map(robot: Robot, simulation: Simulation, tmp_path: Path) -> None:
    for scan in simulation.records[:60]:
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == 60)
    map_url = str(tmp_path / "map.yaml")
    assert call(robot, "nav2_msgs", "SaveMap", "map_saver/save_map", map_url=map_url).result
    assert call(robot, "nav2_msgs", "LoadMap", "map_server/load_map", map_url="/no/map.yaml").result == 1
    answer = call(robot, "nav2_msgs", "LoadMap", "map_server/load_map", map_url=map_url)
    assert answer.result == 0
    assert answer.map.info.width > 1
    initial_pose = robot.node.create_publisher(PoseWithCovarianceStamped, "initialpose", 10)
    robot.until(lambda: initial_pose.get_subscription_count() == 1)
    initial_pose.publish(robot.poses[39])
    robot.until(lambda: not robot.mapper.mapper.lost)
    for scan in simulation.records[40:50]:
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == 70)
    for then, now in zip(robot.poses[40:50], robot.poses[60:70], strict=True):
        before, after = then.pose.pose.position, now.pose.pose.position
        assert math.hypot(before.x - after.x, before.y - after.y) < 0.1
    call(robot, "std_srvs", "Empty", "reinitialize_global_localization")
    assert robot.mapper.mapper.lost


def cells_of(message: OccupancyGrid) -> np.ndarray:
    return np.array(message.data, np.int8).reshape(message.info.height, message.info.width)


def test_update_covers_the_changes_since_the_last_whole_map(robot: Robot, simulation: Simulation) -> None:
    from map_msgs.msg import OccupancyGridUpdate

    updates: list[Any] = []
    robot.node.create_subscription(OccupancyGridUpdate, "map_updates", updates.append, 10)
    robot.until(lambda: robot.mapper._map_out.has_update_subscribers)
    robot.mapper.set_parameters([Parameter("map_updates_interval", value=0.1)])
    for sent, scan in enumerate(simulation.records, 1):
        robot.send_scan(scan)
        robot.until(lambda sent=sent: len(robot.poses) == sent)  # type: ignore[misc]
        if sent % 10:
            continue
        # Stand still for a while: the timer publishes the whole map if it has grown, else an update.
        deadline = time.monotonic() + UPDATE_PAUSE
        robot.until(lambda deadline=deadline: bool(updates) or time.monotonic() > deadline)  # type: ignore[misc]
        if updates and updates[-1].header.stamp == stamp_of(scan.stamp):
            break
        updates.clear()
    update = updates[-1]
    # The last whole map may arrive after the update: topics are not ordered.
    base = robot.mapper._map_out._whole
    robot.until(lambda: np.array_equal(cells_of(robot.maps[-1]), base.cells))
    cells = cells_of(robot.maps[-1])
    part = np.array(update.data, np.int8).reshape(update.height, update.width)
    box = cells[update.y : update.y + update.height, update.x : update.x + update.width]
    assert box.shape == part.shape
    assert all((box != part).any(axis=axis)[[0, -1]].all() for axis in (0, 1)), (
        "the update is no larger than the changes"
    )


def test_scans_of_best_effort_driver_are_received(robot: Robot, simulation: Simulation) -> None:
    robot.node.destroy_publisher(robot.scans)
    robot.scans = robot.node.create_publisher(LaserScan, "scan", qos_profile_sensor_data)
    robot.until(lambda: robot.scans.get_subscription_count() == 1)
    sent = -math.inf
    # The node may not have matched the publisher yet, and then a best-effort message is lost: send it again.
    while not robot.poses:
        if time.monotonic() - sent > RESEND_AFTER:
            robot.send_scan(simulation.records[0])
            sent = time.monotonic()
        robot.until(lambda sent=sent: bool(robot.poses) or time.monotonic() - sent > RESEND_AFTER)  # type: ignore[misc]


def transform(parent: str, child: str, x: float, theta: float, stamp: Time) -> TransformStamped:
    message = TransformStamped(child_frame_id=child)
    message.header.frame_id, message.header.stamp = parent, stamp
    message.transform.translation.x = x
    message.transform.rotation.z, message.transform.rotation.w = math.sin(theta / 2), math.cos(theta / 2)
    return message


def test_pose_of_laser_on_robot_is_read_from_static_transforms(robot: Robot, simulation: Simulation) -> None:
    """The laser is on a mast half a metre in front of the axle and looks backwards."""
    from rce_mapping.inputs import STATIC_TRANSFORMS
    from tf2_msgs.msg import TFMessage

    fixed = robot.node.create_publisher(TFMessage, "/tf_static", STATIC_TRANSFORMS)
    now = stamp_of(1.0)
    fixed.publish(
        TFMessage(
            transforms=[
                transform("base_link", "mast", 0.5, 0.0, now),
                transform("mast", "laser", 0.0, math.pi, now),
                transform("base_link", "wheel", 3.0, 0.0, now),
            ]
        )
    )
    robot.until(lambda: robot.mapper.track.transforms.lookup("laser") == pytest.approx((0.5, 0.0, -math.pi)))
    assert robot.mapper.track.transforms.lookup("unknown") == (0.0, 0.0, 0.0)
    for scan in simulation.records[:3]:
        robot.send_scan(scan, frame="laser")
    robot.until(lambda: len(robot.poses) == 3)
    first = robot.poses[0].pose.pose
    assert (first.position.x, first.orientation.z) == (pytest.approx(0.5), pytest.approx(-1.0))


@pytest.mark.parametrize("parameters", [["odometry_from_tf:=true", "odom_timeout:=60.0"]], indirect=True)
def test_odometry_is_read_from_transforms(robot: Robot, simulation: Simulation) -> None:
    from tf2_msgs.msg import TFMessage

    out = robot.node.create_publisher(TFMessage, "/tf", 100)
    robot.until(lambda: out.get_subscription_count() == 1)
    for scan in simulation.records[:5]:
        assert scan.odometry
        x, _, theta = scan.odometry
        out.publish(TFMessage(transforms=[transform("odom", "base_link", x, theta, stamp_of(scan.stamp))]))
        robot.send_scan(scan)
    robot.until(lambda: len(robot.poses) == 5)
    assert robot.mapper.track._odometry_expected, "no scan has timed out waiting for its odometry"


def test_unknown_mapper_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(sys, "path", [str(PACKAGE), *sys.path])
    rclpy.init(args=["--ros-args", "-p", "mapper:=best"], domain_id=domain("mapping"))
    try:
        from rce_mapping import node

        with pytest.raises(ValueError, match="'best'; it must be one of: graph"):
            node.MapperNode()
    finally:
        rclpy.shutdown()
