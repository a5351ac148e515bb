"""Services of nav2 and slam_toolbox at a mapper node."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from rce.mapping.evaluation.simulation import Simulation

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from geometry_msgs.msg import PoseWithCovarianceStamped
from std_msgs.msg import String

from tests.support.containers.mapper_robot import Robot, call


def test_pause_reset_and_save(robot: Robot, simulation: Simulation, tmp_path: Path) -> None:
    for scan in simulation.records[:20]:
        robot.send_scan(scan)
    robot.until_poses(20)
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
    robot.until_poses(23)
    assert {pose.pose.pose.position.x for pose in robot.poses[20:]} == {robot.poses[19].pose.pose.position.x}
    assert call(robot, "slam_toolbox", "Reset", "slam_toolbox/reset").result == 0
    robot.send_scan(simulation.records[30])
    robot.until_poses(24)
    assert robot.poses[-1].pose.pose.position.x == 0.0


def test_saved_session_is_continued(robot: Robot, simulation: Simulation, tmp_path: Path) -> None:
    file = str(tmp_path / "session.npz")
    for scan in simulation.records[:20]:
        robot.send_scan(scan)
    robot.until_poses(20)
    assert call(robot, "slam_toolbox", "SerializePoseGraph", "slam_toolbox/serialize_map", filename=file).result == 0
    robot.send_scan(simulation.records[20])
    robot.until_poses(21)
    call(robot, "slam_toolbox", "Reset", "slam_toolbox/reset")
    call(robot, "slam_toolbox", "DeserializePoseGraph", "slam_toolbox/deserialize_map", filename=file)
    robot.send_scan(simulation.records[20])
    robot.until_poses(22)
    assert robot.poses[21].pose.pose == robot.poses[20].pose.pose
    robot.until(lambda: len(robot.paths[-1].poses) >= 20)
    answer = call(robot, "slam_toolbox", "SerializePoseGraph", "slam_toolbox/serialize_map", filename="/proc/no/file")
    assert answer.result == 255


def test_robot_is_localised_in_loaded_map(robot: Robot, simulation: Simulation, tmp_path: Path) -> None:
    for scan in simulation.records[:60]:
        robot.send_scan(scan)
    robot.until_poses(60)
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
    robot.until_poses(70)
    for then, now in zip(robot.poses[40:50], robot.poses[60:70], strict=True):
        before, after = then.pose.pose.position, now.pose.pose.position
        assert math.hypot(before.x - after.x, before.y - after.y) < 0.1
    call(robot, "std_srvs", "Empty", "reinitialize_global_localization")
    assert robot.mapper.mapper.lost


@pytest.mark.parametrize("name", ["", "file://", "~no-such-user/map", "/proc/no/map"])
def test_unusable_file_is_answered(robot: Robot, name: str) -> None:
    assert not call(robot, "nav2_msgs", "SaveMap", "map_saver/save_map", map_url=name).result
    assert call(robot, "slam_toolbox", "SaveMap", "slam_toolbox/save_map", name=String(data=name)).result == 255
    assert call(robot, "nav2_msgs", "LoadMap", "map_server/load_map", map_url=name).result != 0


def test_damaged_map_is_answered(robot: Robot, tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("resolution: 0.05\n")
    answer = call(robot, "nav2_msgs", "LoadMap", "map_server/load_map", map_url=str(tmp_path / "map.yaml"))
    assert answer.result == answer.RESULT_INVALID_MAP_DATA


def test_url_of_file_is_accepted(robot: Robot, tmp_path: Path) -> None:
    assert call(robot, "nav2_msgs", "SaveMap", "map_saver/save_map", map_url=f"file://{tmp_path}/map").result
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.pgm", "map.yaml"]


def test_node_that_only_localises_has_no_session_to_save(robot: Robot, tmp_path: Path) -> None:
    url = f"{tmp_path}/map.yaml"
    assert call(robot, "nav2_msgs", "SaveMap", "map_saver/save_map", map_url=url).result
    assert call(robot, "nav2_msgs", "LoadMap", "map_server/load_map", map_url=url).result == 0
    answer = call(robot, "slam_toolbox", "SerializePoseGraph", "slam_toolbox/serialize_map", filename=f"{tmp_path}/s")
    assert answer.result == answer.RESULT_FAILED_TO_WRITE_FILE
