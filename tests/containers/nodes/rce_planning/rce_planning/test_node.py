"""The planner node."""

from __future__ import annotations

from typing import Any

from rce.mapping.geometry import Pose
from rce.mapping.grid import OccupancyGrid
from rce.mapping.robot import grid_of
from tests.support.planning import walled


def stamped(x: float, y: float, frame: str = "map") -> Any:
    from geometry_msgs.msg import PoseStamped
    from rce_mapping.messages import fill_pose

    message = PoseStamped()
    message.header.frame_id = frame
    fill_pose(message.pose, float(x), float(y), 0.0)
    return message


def give_map(world: Any, grid: OccupancyGrid) -> None:
    from builtin_interfaces.msg import Time
    from nav_msgs.msg import OccupancyGrid as GridMessage
    from rce_mapping.map_output import LATCHED
    from rce_mapping.messages import grid_message

    seen: list[GridMessage] = []
    world.node.create_subscription(GridMessage, "/global_costmap/costmap", seen.append, LATCHED)
    world.node.create_publisher(GridMessage, "/map", LATCHED).publish(grid_message(grid, Time(sec=1), "map"))
    world.until(lambda: bool(seen))
    assert seen[0].info.width == grid.cells.shape[1]


def test_goal_gets_a_path_or_the_code_of_its_error(world: Any) -> None:
    """One node for all requests, since each start of ROS takes a second."""
    from nav_msgs.msg import Path
    from rce_mapping.map_output import LATCHED

    result = world.compute(start=stamped(2, 2), goal=stamped(8, 2), use_start=True)
    assert (result.error_code, "no map yet" in result.error_msg) == (200, True)
    give_map(world, walled())
    paths: list[Path] = []
    world.node.create_subscription(Path, "/path", paths.append, LATCHED)
    for planner in ("", "GridBased", "hybrid", "voronoi"):
        result = world.compute(start=stamped(2, 2), goal=stamped(8, 2), use_start=True, planner_id=planner)
        assert result.error_code == 0, result.error_msg
        assert result.path.header.frame_id == "map"
        assert max(each.pose.position.y for each in result.path.poses) > 8
        assert result.planning_time.sec + result.planning_time.nanosec > 0
    world.until(lambda: bool(paths))
    for fields, code in (
        ({"planner_id": "magic"}, 201),
        ({"use_start": False}, 202),
        ({"start": stamped(2, 2, "odom")}, 202),
        ({"start": stamped(-5, 2)}, 203),
        ({"goal": stamped(2, 50)}, 204),
        ({"start": stamped(5.05, 2)}, 205),
        ({"goal": stamped(5.05, 2)}, 206),
    ):
        given = {"start": stamped(2, 2), "goal": stamped(8, 2), "use_start": True} | fields
        result = world.compute(**given)
        assert (result.error_code, bool(result.error_msg)) == (code, True)
        assert not result.path.poses
    give_map(world, walled(gap=0))
    assert world.compute(start=stamped(2, 2), goal=stamped(8, 2), use_start=True).error_code == 208


def test_service_answers_with_a_plan_and_without_one_if_there_is_none(world: Any) -> None:
    from nav_msgs.srv import GetPlan

    give_map(world, walled())
    client = world.node.create_client(GetPlan, "/plan")
    world.until(client.service_is_ready)

    def ask(goal: Any, tolerance: float) -> int:
        answer = client.call_async(GetPlan.Request(start=stamped(2, 2), goal=goal, tolerance=tolerance))
        world.until(answer.done)
        return len(answer.result().plan.poses)

    assert ask(stamped(8, 2), 0.0) > 50
    assert ask(stamped(5.05, 2), 0.0) == 0
    assert ask(stamped(5.05, 2), 1.0) > 10


def test_map_that_is_no_map_leaves_the_last_one(world: Any) -> None:
    from nav_msgs.msg import OccupancyGrid as GridMessage

    give_map(world, walled())
    costmap = world.planner._costmap
    world.planner._on_map(GridMessage())
    assert world.planner._costmap is costmap


def test_start_is_the_robot_in_tf(world: Any) -> None:
    give_map(world, walled())
    world.planner._robot._within["base_link"] = "map", Pose(2.0, 2.0, 0.0)
    assert world.compute(goal=stamped(8, 2)).error_code == 0


def test_costs_are_those_that_nav2_publishes(interfaces: None) -> None:
    import rclpy.serialization
    from builtin_interfaces.msg import Time
    from rce_mapping.messages import grid_message
    from rce_planning.messages import costmap_message

    from rce.planning.planner import PlannerSettings

    message = costmap_message(PlannerSettings().costmap(walled()), grid_message(walled(), Time(), "map"))
    cells = grid_of(rclpy.serialization.serialize_message(message)).cells
    assert cells[10, 50] == 100
    assert cells[10, 49] == 99
    assert 0 < cells[10, 45] < 99
    assert cells[10, 20] == 0
