"""Services of nav2 and slam_toolbox that control a mapper, under their usual names.

A service is offered only if its type is installed; provisioning builds the types.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from std_srvs.srv import Empty

from rce.errors import InvalidRequest, NotFound, RceError
from rce.mapping.files.maps import read_map
from rce.mapping.files.outputs import write_map
from rce.mapping.files.sessions import Relocating, resume_session, save_session
from rce.mapping.geometry import Pose
from rce.mapping.localiser import Localiser
from rce.mapping.mappers import AnyMapper

from . import messages
from .optional import nav2, slam_toolbox
from .parameters import text

if TYPE_CHECKING:
    from .node import MapperNode


class Services:
    """Services and the topic `initialpose` of one mapper node.

    Paths in requests refer to the machine, or the environment, in which the node runs.
    """

    def __init__(self, node: MapperNode) -> None:
        """Create the services of a node."""
        self._node = node
        self._frame = text(node, "map_frame")
        self._offer(nav2, "SaveMap", "map_saver/save_map", self._save_for_nav2)
        self._offer(slam_toolbox, "SaveMap", "slam_toolbox/save_map", self._save)
        self._offer(slam_toolbox, "Pause", "slam_toolbox/pause_new_measurements", self._pause)
        self._offer(nav2, "LoadMap", "map_server/load_map", self._load)
        self._offer(slam_toolbox, "SerializePoseGraph", "slam_toolbox/serialize_map", self._serialize)
        self._offer(slam_toolbox, "DeserializePoseGraph", "slam_toolbox/deserialize_map", self._deserialize)
        Node.create_service(node, Empty, "reinitialize_global_localization", self._search)
        node.create_subscription(PoseWithCovarianceStamped, "initialpose", self._on_initial_pose, 10)
        self._offer(slam_toolbox, "Reset", "slam_toolbox/reset", self._reset)

    def _offer(self, package: Any, kind: str, name: str, handler: Any) -> None:
        """Create a service unless its package is not installed."""
        if package is not None:
            Node.create_service(self._node, getattr(package, kind), name, handler)

    def _save_for_nav2(self, request: Any, response: Any) -> Any:
        """Save the map as `map_url`.pgm and .yaml, as map_server reads it; thresholds of 0 mean those of map_server."""
        response.result = attempt(
            self._node,
            lambda: self._write(request.map_url, request.occupied_thresh or None, request.free_thresh or None),
        )
        return response

    def _save(self, request: Any, response: Any) -> Any:
        """Save the map as `name`.pgm and .yaml."""
        saved = attempt(self._node, lambda: self._write(request.name.data))
        response.result = response.RESULT_SUCCESS if saved else response.RESULT_UNDEFINED_FAILURE
        return response

    def _pause(self, _request: Any, response: Any) -> Any:
        """Pause or resume mapping; while it is paused, each scan is answered with the last pose."""
        self._node.track.paused = not self._node.track.paused
        response.status = True
        return response

    def _reset(self, request: Any, response: Any) -> Any:
        """Start an empty map."""
        self._node.reset()
        self._node.track.paused = request.pause_new_measurements
        response.result = response.RESULT_SUCCESS
        return response

    def _load(self, request: Any, response: Any) -> Any:
        """Localise the robot in a map in the format of map_server, from `initialpose` or by a search."""
        response.result = response.RESULT_SUCCESS
        try:
            grid = read_map(file_of(request.map_url))
        except NotFound as error:
            self._node.get_logger().error(str(error))
            response.result = response.RESULT_MAP_DOES_NOT_EXIST
        except (RceError, OSError) as error:
            self._node.get_logger().error(str(error))
            response.result = response.RESULT_INVALID_MAP_DATA
        else:
            self._node.use(Localiser(grid, settings=self._node.settings))
            response.map = messages.grid_message(grid, self._node.get_clock().now().to_msg(), self._frame)
        return response

    def _serialize(self, request: Any, response: Any) -> Any:
        """Save the whole session: map, poses and everything that is needed to continue."""
        saved = attempt(self._node, lambda: save_session(self._mapper(), file_of(request.filename)))
        response.result = response.RESULT_SUCCESS if saved else response.RESULT_FAILED_TO_WRITE_FILE
        return response

    def _deserialize(self, request: Any, response: Any) -> Any:
        """Continue a saved session at the last or at a given pose, or (LOCALIZE_AT_POSE) only localise in its map.

        The response of slam_toolbox is empty; errors are logged.
        """
        attempt(self._node, lambda: self._resume(request))
        return response

    def _resume(self, request: Any) -> None:
        mapper = resume_session(file_of(request.filename))
        at = request.initial_pose
        pose = self._node.track.in_laser_frame(Pose(at.x, at.y, at.theta))
        if request.match_type == request.LOCALIZE_AT_POSE:
            self._node.use(Localiser(mapper.grid(), pose, self._node.settings))
            return
        if request.match_type == request.START_AT_GIVEN_POSE:
            mapper.relocate(pose)
        self._node.use(mapper)

    def _mapper(self) -> AnyMapper:
        """Return the mapper whose session can be saved.

        Raises:
            InvalidRequest: The node only localises.
        """
        mapper = self._node.mapper
        mapper = mapper.mapper if isinstance(mapper, Relocating) else mapper
        if isinstance(mapper, AnyMapper):
            return mapper
        raise InvalidRequest("no session to save: the node only localises the robot in a map that was loaded")

    def _on_initial_pose(self, message: PoseWithCovarianceStamped) -> None:
        """Set the pose of the robot."""
        pose = self._node.track.in_laser_frame(messages.pose_from(message))
        mapper = self._node.mapper
        if isinstance(mapper, Localiser | AnyMapper):
            mapper.relocate(pose)

    def _search(self, _request: Empty.Request, response: Empty.Response) -> Empty.Response:
        """Search the robot in the whole map, and continue from there."""
        mapper = self._node.mapper
        if isinstance(mapper, Localiser):
            mapper.relocate(None)
        elif isinstance(mapper, AnyMapper):
            self._node.mapper = Relocating(mapper)
        return response

    def _write(self, path: str, occupied: float | None = None, free: float | None = None) -> None:
        write_map(file_of(path), self._node.mapper.grid(), occupied, free)


def attempt(node: Node, action: Callable[[], object]) -> bool:
    """Return whether an action succeeds; log the error if not, since the responses of services have no field for it."""
    try:
        action()
    except (RceError, OSError) as error:
        node.get_logger().error(str(error))
        return False
    return True


def file_of(name: str) -> Path:
    """Return the path of a file name or of a URL `file://…`.

    Raises:
        InvalidRequest: The name is empty, or begins with the home directory of an unknown user.
    """
    path = name.removeprefix("file://")
    if not path:
        raise InvalidRequest("the name of the file is empty")
    try:
        return Path(path).expanduser()
    except RuntimeError as error:
        raise InvalidRequest(f"{path}: {error}") from None
