"""ROS 2 node `planner`: plans paths on a map.

Subscriptions: `/map` (transient local); `/tf` and `/tf_static` for the pose of the robot. Action:
`/compute_path_to_pose` (nav2_msgs/action/ComputePathToPose, with the error codes of Nav2 1.4, ROS 2 Kilted). Service:
`/plan` (nav_msgs/srv/GetPlan). Publications: `/path`, the newest path; `/global_costmap/costmap`, the costs of each map
that the node has taken.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from builtin_interfaces.msg import Duration
from nav2_msgs.action import ComputePathToPose
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.srv import GetPlan
from rce_mapping.map_output import LATCHED
from rce_mapping.messages import grid_from
from rce_mapping.parameters import text
from rclpy.action.server import ActionServer
from rclpy.node import Node

from rce.api.map_jobs import PLANNERS
from rce.errors import InvalidRequest, RceError
from rce.mapping.geometry import Pose
from rce.planning.costmap import Costmap
from rce.planning.failures import NoPath, Reason
from rce.planning.planner import PlannedPath, PlannerSettings, plan

from .messages import costmap_message, path_message, pose_from
from .parameters import declare, settings_of
from .transforms import RobotPose

Result = ComputePathToPose.Result
CODES = {
    Reason.START_OUTSIDE_MAP: Result.START_OUTSIDE_MAP,
    Reason.GOAL_OUTSIDE_MAP: Result.GOAL_OUTSIDE_MAP,
    Reason.START_OCCUPIED: Result.START_OCCUPIED,
    Reason.GOAL_OCCUPIED: Result.GOAL_OCCUPIED,
    Reason.TIMEOUT: Result.TIMEOUT,
    Reason.NO_VALID_PATH: Result.NO_VALID_PATH,
}
GRID_BASED = "GridBased"  # planner_id of Nav2's default configuration


class Refused(RceError):
    """A request that cannot be planned; `code` of the action's result."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.result_code = code


class PlannerNode(Node):
    """Node around the planners of `rce.planning`."""

    def __init__(self) -> None:
        """Declare the parameters, and wait for a map."""
        super().__init__("planner")
        declare(self)
        self.settings = settings_of(self)
        self._frame = text(self, "global_frame")
        self._costmap: Costmap | None = None
        self._robot = RobotPose(self, self._frame, text(self, "robot_base_frame"))
        self._paths = self.create_publisher(Path, "/path", LATCHED)
        self._costmaps = self.create_publisher(OccupancyGrid, "/global_costmap/costmap", LATCHED)
        self.create_subscription(OccupancyGrid, "/map", self._on_map, LATCHED)
        self.create_service(GetPlan, "/plan", self._on_get_plan)
        self._action = ActionServer(self, ComputePathToPose, "/compute_path_to_pose", self._on_goal)

    def destroy_node(self) -> None:
        """Destroy the action before the node."""
        self._action.destroy()
        super().destroy_node()

    def _on_map(self, message: OccupancyGrid) -> None:
        try:
            costmap = self.settings.costmap(grid_from(message))
        except InvalidRequest as error:
            self.get_logger().error(f"a map on /map is not used: {error}")
            return
        self._costmap = costmap
        self._costmaps.publish(costmap_message(costmap, message))

    def _on_goal(self, handle: Any) -> Any:
        """Plan for a goal of the action; a failure aborts it with its code and message."""
        request, result = handle.request, Result()
        try:
            settings = self._settings_for(request.planner_id)
            start = self._pose(request.start) if request.use_start else self._robot_pose()
            path = self._plan(start, self._pose(request.goal), settings)
        except RceError as error:
            result.error_code = error_code(error)
            result.error_msg = str(error)
            handle.abort()
            return result
        result.path = self._publish(path)
        whole, part = divmod(path.seconds, 1.0)
        result.planning_time = Duration(sec=int(whole), nanosec=int(part * 1e9))
        handle.succeed()
        return result

    def _on_get_plan(self, request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        """Plan for a request of the service; the response of a failure is empty, and the error is logged."""
        settings = replace(self.settings, tolerance=max(self.settings.tolerance, request.tolerance))
        try:
            path = self._plan(self._pose(request.start), self._pose(request.goal), settings)
        except RceError as error:
            self.get_logger().error(str(error))
        else:
            response.plan = self._publish(path)
        return response

    def _settings_for(self, planner: str) -> PlannerSettings:
        if planner in ("", GRID_BASED):
            return self.settings
        found = next((each for each in PLANNERS if each == planner), None)
        if found is None:
            known = ", ".join((*PLANNERS, GRID_BASED))
            raise Refused(
                Result.INVALID_PLANNER, f"there is no planner {planner!r}; planner_id must be one of: {known}"
            )
        return replace(self.settings, planner=found)

    def _pose(self, message: Any) -> Pose:
        frame = message.header.frame_id.lstrip("/")
        if frame not in ("", self._frame):
            raise Refused(Result.TF_ERROR, f"the pose is in the frame {frame!r}; it must be in {self._frame!r}")
        return pose_from(message.pose)

    def _robot_pose(self) -> Pose:
        pose = self._robot.newest()
        if pose is None:
            reason = f"no transforms in /tf lead from {self._frame} to the robot: set use_start, or publish them"
            raise Refused(Result.TF_ERROR, reason)
        return pose

    def _plan(self, start: Pose, goal: Pose, settings: PlannerSettings) -> PlannedPath:
        if self._costmap is None:
            raise Refused(Result.UNKNOWN, "there is no map yet: publish one on /map, or give one with `rce plan --env`")
        return plan(self._costmap, start, goal, settings)

    def _publish(self, path: PlannedPath) -> Path:
        message = path_message(path.poses, self.get_clock().now().to_msg(), self._frame)
        self._paths.publish(message)
        return message


def error_code(error: RceError) -> int:
    """Return the code of Nav2's action for an error."""
    match error:
        case NoPath():
            return int(CODES[error.reason])
        case Refused():
            return int(error.result_code)
    return int(Result.UNKNOWN)
