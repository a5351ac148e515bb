"""The services by which users of nav2 and slam_toolbox steer a mapper, under the names that they know.

A service whose types are not installed is not offered; provisioning builds them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from std_srvs.srv import Empty

from rce.errors import InvalidRequest, NotFound, RceError
from rce.mapping.geometry import Pose
from rce.mapping.localiser import Localiser
from rce.mapping.map_files import read_map
from rce.mapping.mappers import AnyMapper
from rce.mapping.outputs import write_map
from rce.mapping.session import Relocating, resume_session, save_session

from . import messages
from .optional import nav2, slam_toolbox
from .parameters import text

if TYPE_CHECKING:
    from .node import MapperNode


class Services:
    """Of one mapper. Paths are on the machine, or in the environment, in which the node runs."""

    def __init__(self, node: MapperNode) -> None:
        self._node = node
        self._frame = text(node, "map_frame")
        self._offer(nav2, "SaveMap", "map_saver/save_map", self._save_for_nav2)
        self._offer(slam_toolbox, "SaveMap", "slam_toolbox/save_map", self._save)
        self._offer(slam_toolbox, "Pause", "slam_toolbox/pause_new_measurements", self._pause)
        self._offer(nav2, "LoadMap", "map_server/load_map", self._load)
        self._offer(slam_toolbox, "SerializePoseGraph", "slam_toolbox/serialize_map", self._serialize)
        self._offer(slam_toolbox, "DeserializePoseGraph", "slam_toolbox/deserialize_map", self._deserialize)
        Node.create_service(node, Empty, "reinitialize_global_localization", self._search)
        node.create_subscription(PoseWithCovarianceStamped, "initialpose", self._place, 10)
        self._offer(slam_toolbox, "Reset", "slam_toolbox/reset", self._reset)

    def _offer(self, package: Any, kind: str, name: str, answer: Any) -> None:
        if package is not None:
            Node.create_service(self._node, getattr(package, kind), name, answer)

    def _save_for_nav2(self, request: Any, response: Any) -> Any:
        """The map as map_server reads it: `map_url` without an extension; thresholds of 0 are map_server's own."""
        response.result = self._try(
            lambda: self._write(request.map_url, request.occupied_thresh or None, request.free_thresh or None)
        )
        return response

    def _save(self, request: Any, response: Any) -> Any:
        saved = self._try(lambda: self._write(request.name.data))
        response.result = response.RESULT_SUCCESS if saved else response.RESULT_UNDEFINED_FAILURE
        return response

    def _pause(self, _request: Any, response: Any) -> Any:
        """Take no scans, or take them again; each is answered with the last pose meanwhile."""
        self._node.track.paused = not self._node.track.paused
        response.status = True
        return response

    def _reset(self, request: Any, response: Any) -> Any:
        self._node.reset()
        self._node.track.paused = request.pause_new_measurements
        response.result = response.RESULT_SUCCESS
        return response

    def _load(self, request: Any, response: Any) -> Any:
        """Follow the robot in a map that map_server can read, from where `initialpose` says, else after a search."""
        response.result = response.RESULT_SUCCESS
        try:
            grid = read_map(_file(request.map_url))
        except NotFound as error:
            self._node.get_logger().error(str(error))
            response.result = response.RESULT_MAP_DOES_NOT_EXIST
        except (RceError, OSError) as error:
            self._node.get_logger().error(str(error))
            response.result = response.RESULT_INVALID_MAP_DATA
        else:
            self._node.begin(Localiser(grid, settings=self._node.settings))
            response.map = messages.grid_message(grid, self._node.get_clock().now().to_msg(), self._frame)
        return response

    def _serialize(self, request: Any, response: Any) -> Any:
        """The whole session: map, poses, all that is needed to go on."""
        saved = self._try(lambda: save_session(self._mapper(), _file(request.filename)))
        response.result = response.RESULT_SUCCESS if saved else response.RESULT_FAILED_TO_WRITE_FILE
        return response

    def _deserialize(self, request: Any, response: Any) -> Any:
        """Go on with a saved session: where the robot was then, from a given pose, or (LOCALIZE_AT_POSE) in its map
        without changing it. slam_toolbox's response is empty: what goes wrong stands in the log."""
        self._try(lambda: self._resume(request))
        return response

    def _resume(self, request: Any) -> None:
        mapper = resume_session(_file(request.filename))
        at = request.initial_pose
        pose = self._node.track.in_laser_frame(Pose(at.x, at.y, at.theta))
        if request.match_type == request.LOCALIZE_AT_POSE:
            self._node.begin(Localiser(mapper.grid(), pose, self._node.settings))
            return
        if request.match_type == request.START_AT_GIVEN_POSE:
            mapper.relocate(pose)
        self._node.begin(mapper)

    def _mapper(self) -> AnyMapper:
        mapper = self._node.mapper
        mapper = mapper.mapper if isinstance(mapper, Relocating) else mapper
        if isinstance(mapper, AnyMapper):
            return mapper
        raise InvalidRequest("the node only follows the robot in a map that it has loaded: there is no session to save")

    def _place(self, message: PoseWithCovarianceStamped) -> None:
        """`initialpose`: where the robot is, by whoever knows it."""
        pose = self._node.track.in_laser_frame(messages.pose_from(message))
        mapper = self._node.mapper
        if isinstance(mapper, Localiser | AnyMapper):
            mapper.relocate(pose)

    def _search(self, _request: Empty.Request, response: Empty.Response) -> Empty.Response:
        """The robot may be anywhere in the map: find it, and go on from there."""
        mapper = self._node.mapper
        if isinstance(mapper, Localiser):
            mapper.relocate(None)
        elif isinstance(mapper, AnyMapper):
            self._node.mapper = Relocating(mapper)
        return response

    def _write(self, path: str, occupied: float | None = None, free: float | None = None) -> None:
        write_map(_file(path), self._node.mapper.grid(), occupied, free)

    def _try(self, action: Any) -> bool:
        """Services of nav2 and slam_toolbox can only say that it failed; why stands in the log."""
        try:
            action()
        except (RceError, OSError) as error:
            self._node.get_logger().error(str(error))
            return False
        return True


def _file(name: str) -> Path:
    """The file of a name, or of a URL `file://…`. InvalidRequest."""
    path = name.removeprefix("file://")
    if not path:
        raise InvalidRequest("the name of the file is empty")
    return Path(path).expanduser()
