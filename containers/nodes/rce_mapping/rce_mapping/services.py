"""The services by which users of nav2 and slam_toolbox steer a mapper, under the names that they know.

A service whose types are not installed is not offered; provisioning builds them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.node import Node

from rce.errors import InvalidRequest, RceError
from rce.mapping.outputs import write_map

from .optional import nav2, slam_toolbox

if TYPE_CHECKING:
    from .node import MapperNode


class Services:
    """Of one mapper. Paths are on the machine, or in the environment, in which the node runs."""

    def __init__(self, node: MapperNode) -> None:
        self._node = node
        self._offer(nav2, "SaveMap", "map_saver/save_map", self._save_for_nav2)
        self._offer(slam_toolbox, "SaveMap", "slam_toolbox/save_map", self._save)
        self._offer(slam_toolbox, "Pause", "slam_toolbox/pause_new_measurements", self._pause)
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
        self._node.paused = not self._node.paused
        response.status = True
        return response

    def _reset(self, request: Any, response: Any) -> Any:
        self._node.reset()
        self._node.paused = request.pause_new_measurements
        response.result = response.RESULT_SUCCESS
        return response

    def _write(self, path: str, occupied: float | None = None, free: float | None = None) -> None:
        if not path:
            raise InvalidRequest("the name of the map is empty")
        write_map(Path(path).expanduser(), self._node.mapper.grid(), occupied, free)

    def _try(self, action: Any) -> bool:
        """Services of nav2 and slam_toolbox can only say that it failed; why stands in the log."""
        try:
            action()
        except (RceError, OSError) as error:
            self._node.get_logger().error(str(error))
            return False
        return True
