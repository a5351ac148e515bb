"""The robot's side: the front end, key frames for the cloud, and a pose that follows the cloud's corrections."""

from __future__ import annotations

import secrets
from dataclasses import dataclass

import numpy as np

from rce.mapping.clouds import Sweep
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.odometry.tracker import Tracked
from rce.mapping3d.offload.follower import PoseFollower
from rce.mapping3d.offload.messages import message_of
from rce.mapping3d.offload.outbox import Outbox
from rce.mapping3d.poses import Pose
from rce.mapping3d.sensors import front_end

MEMORY = 32 << 20  # bytes of key frames that wait: some 400, which a hand-held camera makes in two minutes
FIRST_MAP = "map"


@dataclass(frozen=True, slots=True)
class Located:
    """Pose of a robot in its map.

    Attributes:
        pose: (4, 4) sensor to the frame of the map, without jumps.
        map: Frame of the map; it changes when maps join.
        tracked: The answer of the front end.
    """

    pose: Pose
    map: str
    tracked: Tracked


class RobotTracking:
    """Tracking on a robot, with or without a line to the cloud.

    Attributes:
        run: Name of this run, which differs from those of all others.
        outbox: Key frames that the cloud does not have yet.
        map: Frame of the map on which the cloud has placed the newest key frame that it told of.
    """

    def __init__(self, camera: Camera | None, memory: int = MEMORY) -> None:
        """Begin.

        Args:
            camera: Camera of the frames; None for sweeps of a lidar.
            memory: Bytes of key frames that wait for the line.
        """
        self.run = secrets.token_hex(8)
        self.outbox = Outbox(memory)
        self.map = FIRST_MAP
        self._tracker = front_end(camera)
        self._links: dict[int, tuple[int, Pose]] = {}  # by index of a key frame: its reference and the pose to it
        self._stamps: dict[int, int] = {}  # indices of key frames by their stamps, microseconds
        self._known: dict[int, Pose] = {}  # by index: the pose that the cloud told
        self._newest = -1  # index of the newest key frame of which the cloud told
        self._last = (-1, np.eye(4))  # reference and pose to it of the last frame
        self._follower = PoseFollower()

    @property
    def key_frames(self) -> int:
        """Number of key frames so far."""
        return len(self._links)

    def add(self, frame: RgbdFrame | Sweep) -> Located:
        """Track a frame; its key frame, if it makes one, goes into the outbox."""
        tracked = self._tracker.add(frame)
        self._last = tracked.reference, tracked.pose
        if tracked.key is not None:
            index = tracked.key.index
            self._links[index] = self._last
            self._stamps[round(frame.stamp * 1e6)] = index
            self._last = index, np.eye(4)
            self.outbox.add(message_of(self.run, tracked))
        return Located(self._follower.move(frame.stamp, self._target()), self.map, tracked)

    def correct(self, poses: dict[int, tuple[Pose, str]]) -> None:
        """Apply what the cloud tells: by stamp of a key frame, microseconds, its pose (4, 4) and the frame of its map.

        Those of key frames that this run did not make are ignored.
        """
        for stamp, (pose, frame) in poses.items():
            index = self._stamps.get(stamp)
            if index is not None:
                self._known[index] = pose
                if index >= self._newest:
                    self._newest, self.map = index, frame
        self._follower.correct(self._target())

    def key_pose(self, index: int) -> Pose:
        """Return the pose of a key frame: as the cloud told, or from the nearest one before of which it told."""
        way = np.eye(4)
        while index in self._links and index not in self._known:
            index, step = self._links[index]
            way = step @ way
        return self._known.get(index, np.eye(4)) @ way

    def _target(self) -> Pose:
        reference, pose = self._last
        return self.key_pose(reference) @ pose
