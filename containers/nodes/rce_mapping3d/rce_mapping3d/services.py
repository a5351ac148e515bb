"""Services that control a mapper as a whole: optimise, reset, and saved sessions.

Those of slam_toolbox are offered if its types are installed; provisioning builds them. Paths refer to the machine, or
the environment, in which the node runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rce_mapping.optional import slam_toolbox
from rce_mapping.services import attempt, file_of
from std_srvs.srv import Trigger

from rce.mapping3d.offload.sessions import resume_session, save_session
from rce.mapping3d.offload.shared_map import SharedMap

if TYPE_CHECKING:
    from .node import Mapper3dNode


class Services:
    """Services of a mapper node."""

    def __init__(self, node: Mapper3dNode) -> None:
        """Create the services of a node."""
        self._node = node
        node.create_service(Trigger, "optimise", self._optimise)
        node.create_service(Trigger, "reset", self._reset)
        if slam_toolbox is not None:
            name = "slam_toolbox/serialize_map"
            node.create_service(slam_toolbox.SerializePoseGraph, name, self._serialize)
            name = "slam_toolbox/deserialize_map"
            node.create_service(slam_toolbox.DeserializePoseGraph, name, self._deserialize)

    def _optimise(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Look for maps that can be joined, move all key frames to the most likely poses, and tell the robots."""
        self._node.shared.optimise()
        self._node.tell()
        response.success = True
        return response

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Start an empty map."""
        self._node.use(SharedMap(self._node.shared.robots, self._node.shared.sensor))
        response.success = True
        return response

    def _serialize(self, request: Any, response: Any) -> Any:
        """Save the session: key frames, poses, and all that is needed to continue."""
        saved = attempt(self._node, lambda: save_session(self._node.shared, file_of(request.filename)))
        response.result = response.RESULT_SUCCESS if saved else response.RESULT_FAILED_TO_WRITE_FILE
        return response

    def _deserialize(self, request: Any, response: Any) -> Any:
        """Continue a saved session. Robots find themselves on its map as lost ones do. Errors are logged."""
        shared = self._node.shared
        attempt(
            self._node, lambda: self._node.use(resume_session(file_of(request.filename), shared.robots, shared.sensor))
        )
        return response
