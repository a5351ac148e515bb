"""The map and its updates."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.grid import OccupancyGrid as Grid
from tests.support.containers.recording_node import RecordingNode

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from builtin_interfaces.msg import Time
from nav_msgs.msg import OccupancyGrid
from rclpy.parameter import Parameter

from tests.support.containers.mapper_robot import Robot, stamp_of

UPDATE_PAUSE = 0.3  # seconds without new scans, in which several updates are due


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
        robot.until_poses(sent)
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


def grid_of(cells: np.ndarray, x: float = 0.0) -> Grid:
    return Grid(cells.astype(np.int8), 0.05, x, 0.0)


@pytest.fixture
def empty() -> np.ndarray:
    return np.full((4, 6), -1)


def outputs(interfaces: None) -> tuple[RecordingNode, Any]:
    from rce_mapping.map_output import MapOutput

    node = RecordingNode()
    return node, MapOutput(node, "map")


def test_first_update_is_the_whole_map(interfaces: None, empty: np.ndarray) -> None:
    node, output = outputs(interfaces)
    output.update(grid_of(empty), Time(sec=1))
    assert (len(node.sent("map")), node.sent("map_updates")) == (1, [])


def test_update_is_the_smallest_box_of_changes(interfaces: None, empty: np.ndarray) -> None:
    node, output = outputs(interfaces)
    output.publish(grid_of(empty), Time(sec=1))
    output.update(grid_of(empty), Time(sec=2))
    assert node.sent("map_updates") == [], "nothing has changed"
    changed = empty.copy()
    changed[1, 2], changed[2, 4] = 0, 100
    output.update(grid_of(changed), Time(sec=3))
    (update,) = node.sent("map_updates")
    assert (update.x, update.y, update.width, update.height) == (2, 1, 3, 2)
    assert list(update.data) == [0, -1, -1, -1, -1, 100]
    assert (update.header.frame_id, update.header.stamp) == ("map", Time(sec=3))


def test_update_covers_earlier_ones(interfaces: None, empty: np.ndarray) -> None:
    node, output = outputs(interfaces)
    output.publish(grid_of(empty), Time(sec=1))
    first = empty.copy()
    first[0, 0] = 0
    output.update(grid_of(first), Time(sec=2))
    second = first.copy()
    second[3, 5] = 0
    output.update(grid_of(second), Time(sec=3))
    assert [(each.width, each.height) for each in node.sent("map_updates")] == [(1, 1), (6, 4)]


def test_map_that_grew_or_moved_is_published_whole(interfaces: None, empty: np.ndarray) -> None:
    node, output = outputs(interfaces)
    output.publish(grid_of(empty), Time(sec=1))
    output.update(grid_of(np.full((4, 7), -1)), Time(sec=2))
    output.update(grid_of(np.full((4, 7), -1), x=0.5), Time(sec=3))
    assert [message.info.width for message in node.sent("map")] == [6, 7, 7]
    assert node.sent("map")[-1].info.origin.position.x == 0.5
    assert node.sent("map_updates") == []


def test_subscribers_of_updates_are_known(interfaces: None) -> None:
    node, output = outputs(interfaces)
    assert not output.has_update_subscribers
    node.publishers["map_updates"].subscribers = 1
    assert output.has_update_subscribers
