"""The localiser node; how well it localises is tested in tests/rce/mapping/test_localiser.py."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.pose_graph.mapper import GraphMapper

Known = tuple[OccupancyGrid, NDArray[np.float64]]


@pytest.fixture(scope="module")
def known(simulation: Simulation) -> Known:
    """Map of the apartment, and the trajectory in it."""
    mapper = GraphMapper()
    for scan in simulation:
        mapper.add(scan)
    return mapper.grid(), mapper.trajectory()


def truth(known: Known, index: int) -> Pose:
    return Pose(*known[1][index, 1:].tolist())


def initial_pose(pose: Pose) -> list[str]:
    """Return the parameters that start a robot at a pose."""
    values = {"x": pose.x, "y": pose.y, "yaw": pose.theta}
    return ["set_initial_pose:=true", *(f"initial_pose.{name}:={value}" for name, value in values.items())]


def place(message: Any) -> tuple[float, float]:
    return message.pose.pose.position.x, message.pose.pose.position.y


def seconds(message: Any) -> float:
    return float(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)


def test_robot_is_found_tracked_and_searched_again(
    start: Callable[..., Any], simulation: Simulation, known: Known
) -> None:
    world = start("odom_frame_id:=wheels", "transform_tolerance:=0.5")
    world.until(lambda: world.localised == [False])
    world.give_map(known[0])
    for scan in simulation.records[:120]:
        world.scan(scan)
    world.until(lambda: world.localised == [False, True] and bool(world.poses))
    world.until(lambda: math.dist(place(world.poses[-1]), truth(known, 119)[:2]) < 0.15)
    covariance = np.array(world.poses[-1].pose.covariance).reshape(6, 6)
    assert 0 < covariance[0, 0] < 0.1
    assert 0 < covariance[5, 5] < 0.1
    valid = pytest.approx(simulation.records[119].stamp + 0.5, abs=1e-3)
    world.until(lambda: bool(world.transforms) and seconds(world.transforms[-1]) == valid)
    sent = world.transforms[-1]
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "wheels")
    world.call("reinitialize_global_localization")
    world.until(lambda: world.localised == [False, True, False])
    for scan in simulation.records[120:200]:
        world.scan(scan)
    world.until(lambda: world.localised == [False, True, False, True])


def test_initial_pose_may_come_before_the_map(start: Callable[..., Any], simulation: Simulation, known: Known) -> None:
    world = start()
    world.give_pose(Pose(50.0, 50.0, 0.0), "odom")
    world.give_pose(truth(known, 300) @ Pose(0.5, -0.3, 0.2))
    world.give_map(known[0])
    world.scan(simulation.records[300])
    world.until(lambda: bool(world.poses))
    assert math.dist(place(world.poses[0]), truth(known, 300)[:2]) < 0.15


def test_next_map_is_entered_at_the_last_pose(start: Callable[..., Any], simulation: Simulation, known: Known) -> None:
    world = start(*initial_pose(truth(known, 300)))
    world.give_map(known[0])
    for scan in simulation.records[300:310]:
        world.scan(scan)
    moved = dataclasses.replace(known[0], x=known[0].x)
    world.give_map(moved)
    world.scan(simulation.records[310])
    assert world.localiser._pose is not None
    assert math.dist(world.localiser._pose[:2], truth(known, 310)[:2]) < 0.15


def test_scans_of_a_robot_that_stands_are_used_on_request(
    start: Callable[..., Any], simulation: Simulation, known: Known
) -> None:
    world = start("update_min_d:=0.25", "update_min_a:=0.2", *initial_pose(truth(known, 300)))
    world.give_map(known[0])
    used: list[float] = []
    add = world.localiser._localiser.add
    world.localiser._localiser.add = lambda scan: used.append(scan.stamp) or add(scan)
    first = simulation.records[300]
    for seconds in (0.0, 0.1, 0.2):
        world.scan(dataclasses.replace(first, stamp=first.stamp + seconds))
    assert used == [first.stamp]
    world.until(lambda: len(world.transforms) == 3)
    world.call("request_nomotion_update")
    world.scan(dataclasses.replace(first, stamp=first.stamp + 0.3))
    world.scan(dataclasses.replace(first, stamp=first.stamp + 0.4))
    assert len(used) == 2
    assert first.odometry is not None
    moved = first.odometry @ Pose(0.3, 0.0, 0.0)
    world.scan(dataclasses.replace(first, stamp=first.stamp + 0.5, odometry=moved))
    assert len(used) == 3


def test_first_map_may_be_the_only_one_and_a_broken_one_is_none(start: Callable[..., Any], known: Known) -> None:
    from builtin_interfaces.msg import Time
    from nav_msgs.msg import OccupancyGrid as GridMessage
    from rce_mapping.messages import grid_message

    world = start("first_map_only:=true", "tf_broadcast:=false", "laser_min_range:=0.3")
    world.localiser._on_map(GridMessage())
    assert world.localiser._localiser is None
    world.give_map(known[0])
    first = world.localiser._localiser
    world.localiser._on_map(grid_message(known[0], Time(), "map"))
    assert world.localiser._localiser is first
