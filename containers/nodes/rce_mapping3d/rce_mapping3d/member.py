"""Topics and services of one robot of a mapper."""

from __future__ import annotations

import json
import secrets
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetMap, GetPlan
from numpy.typing import NDArray
from rce_mapping.inputs import LOSSLESS
from rce_mapping.map_output import LATCHED
from rce_mapping.messages import grid_message
from sensor_msgs.msg import CompressedImage, PointCloud2
from std_msgs.msg import String, UInt8MultiArray
from std_srvs.srv import Trigger

from rce.errors import InvalidRequest
from rce.mapping.clouds import Sweep
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.offload.messages import decode
from rce.mapping3d.offload.streams import FrameDecoder
from rce.mapping3d.poses import Pose
from rce.mapping3d.sensors import LIDAR, FrontEnd, front_end

from . import messages
from .clouds import CloudInput
from .images import ImageInput
from .transforms import CameraTransform

if TYPE_CHECKING:
    from .node import Mapper3dNode

COVARIANCE_INTERVAL = 1.0  # seconds at least between computations of the covariance
SHARE = 20.0  # multiple of the time that a computation takes, which is longer on larger maps
UNKNOWN = np.diag([1e6] * 6)


class Member:
    """One robot: what it sends, and what it is told.

    Each message of `key_frames`, `frames` and `points`, and each pair of images, is answered by one message of `pose`
    with its stamp. `corrections` has the key frames that have moved since the last message of it.
    """

    def __init__(self, node: Mapper3dNode, name: str, prefix: str) -> None:
        """Create the topics and services of the robot `name`; `prefix` begins their names: `NAME/` or empty."""
        self.name = name
        self._node = node
        self._run = ""  # of the front end in this node
        self._tracker: FrontEnd | None = None
        self._camera: Camera | None = None  # of the front end
        self._decoder = FrameDecoder()
        self._covariance: NDArray[np.float64] = UNKNOWN
        self._covariance_due = -np.inf  # monotonic time
        self._published: tuple[int, list[str]] = -1, []
        self._stamp = Time()
        node.create_subscription(CompressedImage, f"{prefix}key_frames", self._on_key_frame, LOSSLESS)
        if node.shared.sensor == LIDAR:
            self._clouds = CloudInput(node, prefix, self._on_sweep)
        else:
            node.create_subscription(CompressedImage, f"{prefix}frames", self._on_frame_message, LOSSLESS)
            self._images = ImageInput(node, prefix, self._on_frame)
        self._transform = CameraTransform(node, f"{prefix}{node.sensor_frame}")
        self._pose_out = node.create_publisher(PoseWithCovarianceStamped, f"{prefix}pose", LOSSLESS)
        self._corrections_out = node.create_publisher(PathMessage, f"{prefix}corrections", LOSSLESS)
        self._path_out = node.create_publisher(PathMessage, f"{prefix}path", LATCHED)
        self._map_out = node.create_publisher(OccupancyGrid, f"{prefix}map", LATCHED)
        self._cloud_out = node.create_publisher(PointCloud2, f"{prefix}cloud", LATCHED)
        self._mesh_out = node.create_publisher(UInt8MultiArray, f"{prefix}mesh", LATCHED)
        self._team_out = node.create_publisher(String, f"{prefix}team", LATCHED)
        self._files_out = node.create_publisher(UInt8MultiArray, f"{prefix}files", LOSSLESS)
        node.create_service(GetMap, f"{prefix}dynamic_map", self._on_get_map)
        node.create_service(GetPlan, f"{prefix}get_path", self._on_get_path)
        node.create_service(GetPlan, f"{prefix}next_goal", self._on_next_goal)
        node.create_service(Trigger, f"{prefix}export", self._on_export)

    def restart(self) -> None:
        """Continue with another map."""
        self._tracker, self._published = None, (-1, [])

    def publish(self) -> None:
        """Publish what has changed since the last time; map, cloud and mesh only if somebody listens."""
        shared = self._node.shared
        current = len(shared.mapper.store), shared.team(self.name)
        if current == self._published:
            return
        first, self._published = self._published[0] < 0, current
        frame = self._frame()
        self._path_out.publish(messages.path_message(frame, shared.poses(self.name)))
        self._team_out.publish(String(data=json.dumps(current[1])))
        if first or self._map_out.get_subscription_count():
            self._map_out.publish(self._grid())
        if self._cloud_out.get_subscription_count():
            self._cloud_out.publish(messages.cloud_message(shared.cloud(self.name), self._stamp, frame))
        if self._mesh_out.get_subscription_count():
            self._mesh_out.publish(messages.mesh_message(shared.mesh(self.name)))

    def tell(self) -> None:
        """Publish the corrections of this robot, if there are any."""
        corrections = self._node.shared.corrections(self.name)
        if corrections:
            self._corrections_out.publish(messages.path_message(self._frame(), corrections))

    # --- what the robot sends

    def _on_key_frame(self, message: CompressedImage) -> None:
        try:
            key = decode(bytes(message.data))
            added = self._node.shared.add(self.name, key)
        except InvalidRequest as error:
            self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        if added:
            self._stamp = message.header.stamp
            self._node.tell()
            located = self._node.shared.located(self.name)
            assert located is not None
            self._answer(message.header.stamp, located.map, located.pose)

    def _on_frame_message(self, message: CompressedImage) -> None:
        try:
            found = self._decoder.decode(bytes(message.data))
        except InvalidRequest as error:
            self._node.get_logger().warning(str(error), throttle_duration_sec=5.0)
            found = None
        if found is not None:
            self._on_frame(found[0], found[1], message.header.stamp)
        else:  # a message before it was lost
            self._answer(message.header.stamp, self._frame(), np.eye(4), lost=True)

    def _on_frame(self, frame: RgbdFrame, camera: Camera, stamp: Time | None = None) -> None:
        """Track a frame beside the map."""
        if camera != self._camera:
            self._camera, self._tracker = camera, None
        self._track(frame, stamp or messages.stamp_of(frame.stamp))

    def _on_sweep(self, sweep: Sweep, stamp: Time) -> None:
        """Track a sweep beside the map."""
        self._track(sweep, stamp)

    def _track(self, frame: RgbdFrame | Sweep, stamp: Time) -> None:
        shared = self._node.shared
        if self._tracker is None:
            self._run, self._tracker = secrets.token_hex(8), front_end(self._camera)
        tracked = self._tracker.add(frame)
        if tracked.key is not None:
            shared.add_tracked(self.name, self._run, tracked)
            self._node.tell()
        reference = tracked.key.index if tracked.key is not None else tracked.reference
        pose = np.eye(4) if tracked.key is not None else tracked.pose
        at = shared.find(self.name, reference)
        self._stamp = stamp
        self._answer(
            self._stamp, at.map if at else self._frame(), at.pose @ pose if at else np.eye(4), lost=tracked.lost
        )

    def _answer(self, stamp: Time, frame: str, pose: Pose, lost: bool = False) -> None:
        covariance = UNKNOWN if lost else self._current_covariance()
        message = messages.pose_message(0.0, frame, pose, covariance)
        message.header.stamp = stamp
        self._pose_out.publish(message)
        if not lost:
            self._transform.send(stamp, frame, pose)

    def _current_covariance(self) -> NDArray[np.float64]:
        now = time.monotonic()
        if now > self._covariance_due:
            self._covariance = self._node.shared.covariance(self.name)
            taken = time.monotonic() - now
            self._covariance_due = now + max(COVARIANCE_INTERVAL, SHARE * taken)
        return self._covariance

    # --- services

    def _on_get_map(self, _request: GetMap.Request, response: GetMap.Response) -> GetMap.Response:
        response.map = self._grid()
        return response

    def _on_get_path(self, _request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        """Return all key frames of the robot."""
        response.plan = messages.path_message(self._frame(), self._node.shared.poses(self.name))
        return response

    def _on_next_goal(self, _request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
        """Return a plan whose only pose is the next exploration point; without a pose there is none."""
        goal = self._node.shared.next_goal(self.name)
        response.plan.header.frame_id = self._frame()
        response.plan.header.stamp = self._stamp
        if goal is not None:
            pose = PoseStamped(header=response.plan.header)
            messages.fill_pose(pose.pose, goal)
            response.plan.poses = [pose]
        return response

    def _on_export(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Publish the files of the map on `files`; the message has their names."""
        with tempfile.TemporaryDirectory(prefix="rce-map3d-") as directory:
            paths = self._node.shared.write(self.name, Path(directory))
            for path in paths:
                for piece in messages.file_messages(path.name, path.read_bytes()):
                    self._files_out.publish(piece)
        response.success, response.message = True, json.dumps([path.name for path in paths])
        return response

    def _grid(self) -> OccupancyGrid:
        return grid_message(self._node.shared.grid(self.name), self._stamp, f"{self._frame()}_level")

    def _frame(self) -> str:
        located = self._node.shared.located(self.name)
        return located.map if located else self._node.map_frame
