"""A robot has paths planned by the planner node of an environment, which `rce plan` gives a map."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from rce.mapping.files.outputs import write_map
from rce.mapping.grid import OccupancyGrid
from rce.protocol.messages import Qos
from tests.support.e2e.consoles import rce, user_environ
from tests.support.e2e.real_platform import RealPlatform

WAIT = 60.0  # seconds
LATCHED = Qos(reliability="reliable", durability="transient_local", depth=1)
GOAL_OCCUPIED, TF_ERROR = 206, 202  # of Nav2's action ComputePathToPose


def stamped(x: float, y: float) -> dict[str, Any]:
    return {"header": {"frame_id": "map"}, "pose": {"position": {"x": x, "y": y}, "orientation": {"w": 1.0}}}


async def test_robot_gets_paths_by_action_and_service(platform: RealPlatform, tmp_path: Path) -> None:
    cells = np.zeros((80, 80), np.int8)
    cells[:60, 40:42] = 100  # a wall from y = 0 to y = 3
    write_map(tmp_path / "map", OccupancyGrid(cells, 0.05, 0.0, 0.0))
    async with platform.robot("walker") as robot, robot.environment("planning", restart="no") as environment:
        await environment.add_node("planner", "rce_planning", "planner")
        client = await environment.action_client("/compute_path_to_pose", "nav2_msgs/ComputePathToPose")
        transforms = await environment.publisher("/tf_static", "tf2_msgs/TFMessage", qos=LATCHED)
        done = await rce(
            "plan", str(tmp_path / "map.yaml"), "--env", "planning", env=user_environ(tmp_path, platform.url)
        )
        assert "the planner of planning has the map" in done

        async def compute(goal: dict[str, Any], **fields: Any) -> tuple[str, dict[str, Any]]:
            sent = await client.send_goal({"goal": goal, **fields}, timeout=WAIT)
            return await sent.result(WAIT)

        status, result = await compute(stamped(3, 1), start=stamped(1, 1), use_start=True)
        assert (status, result["error_code"]) == ("succeeded", 0)
        poses = [each["pose"]["position"] for each in result["path"]["poses"]]
        assert max(pose["y"] for pose in poses) > 3.2  # around the wall
        assert math.dist((poses[-1]["x"], poses[-1]["y"]), (3, 1)) < 1e-6

        status, result = await compute(stamped(2.05, 1), start=stamped(1, 1), use_start=True)
        assert (status, result["error_code"]) == ("aborted", GOAL_OCCUPIED)
        assert "in an obstacle" in result["error_msg"]

        status, result = await compute(stamped(1, 3))
        assert (status, result["error_code"]) == ("aborted", TF_ERROR)
        place = {"translation": {"x": 1.0, "y": 1.0}, "rotation": {"w": 1.0}}
        await transforms.publish(
            {"transforms": [{"header": {"frame_id": "map"}, "child_frame_id": "base_link", "transform": place}]}
        )
        while result["error_code"] == TF_ERROR:  # until the node has the transform
            status, result = await compute(stamped(1, 3), planner_id="hybrid")
        assert (status, result["error_code"]) == ("succeeded", 0)

        service = await environment.service_client("/plan", "nav_msgs/GetPlan")
        answer = await service.call({"start": stamped(1, 1), "goal": stamped(3, 1), "tolerance": 0.5}, WAIT)
        assert len(answer["plan"]["poses"]) == len(poses)


async def test_map_of_the_repository_is_planned_on(platform: RealPlatform, tmp_path: Path) -> None:
    write_map(tmp_path / "map" / "map", OccupancyGrid(np.zeros((80, 80), np.int8), 0.05, 0.0, 0.0))
    user = user_environ(tmp_path, platform.url)
    await rce("knowledge", "add", "environment", "office.planned", "--map", str(tmp_path / "map"), env=user)
    words = ("--start", "1,1", "--goal", "3,1", "--out", str(tmp_path / "out"))
    assert "2.00 m" in await rce("plan", "--environment", "office.planned", *words, env=user)
    assert (tmp_path / "out" / "path.csv").exists()
    report = await rce("plan", "--map-job", "none", *words, env=user, status=1)
    assert "no job" in report or "none" in report
