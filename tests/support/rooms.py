"""A room of boxes, seen by a camera with depth: exact, without noise."""

from __future__ import annotations

import math

import numpy as np

from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import KeyFrame, RgbdFrame
from rce.mapping3d.poses import Floats, Pose, make_pose

CAMERA = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
ROOM = np.array([[-2.0, -1.5, 0.0], [2.0, 1.5, 2.5]])  # lowest and highest corner, metres, z up
TABLE = np.array([[0.5, -0.5, 0.0], [1.3, 0.5, 0.7]])
WALL_COLORS = np.array([[200, 60, 60], [60, 200, 60], [120, 120, 120]])  # by the axis across the wall
TABLE_COLOR = np.array([180, 140, 80])


def looking(x: float, y: float, z: float, heading: float, down: float = 0.0) -> Pose:
    """Return the pose of a camera in the room; angles in degrees, heading from the x axis to the y axis."""
    yaw, pitch = math.radians(heading), math.radians(down)
    ahead = np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(pitch)])
    right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    return make_pose(np.stack([right, np.cross(ahead, right), ahead], axis=1), [x, y, z])


def view(pose: Pose, robot: int = 0, index: int = 0, camera: Camera = CAMERA) -> KeyFrame:
    """Return what a camera at `pose`, camera to room, sees."""
    rays = camera.rays().reshape(-1, 3).astype(np.float64) @ pose[:3, :3].T
    near, far = _slabs(ROOM, pose[:3, 3], rays)
    depth, axis = far.min(axis=1), far.argmin(axis=1)
    near, far = _slabs(TABLE, pose[:3, 3], rays)
    enter = near.max(axis=1)
    hit = (enter < far.min(axis=1)) & (enter > 0) & (enter < depth)
    colors = np.where(hit[:, None], TABLE_COLOR, WALL_COLORS[axis]).astype(np.uint8)
    shape = camera.height, camera.width
    depths = np.where(hit, enter, depth).astype(np.float32).reshape(shape)
    return KeyFrame(robot, index, RgbdFrame(index / 30, colors.reshape(*shape, 3), depths), camera)


def round_trip(robot: int = 0, count: int = 8) -> list[tuple[KeyFrame, Pose]]:
    """Return key frames of a camera that turns once in the middle of the room, looking slightly down."""
    poses = [looking(-0.5, 0.0, 1.3, 360.0 * i / count, 25.0) for i in range(count)]
    return [(view(pose, robot, i), pose) for i, pose in enumerate(poses)]


def _slabs(box: Floats, eye: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """Return where rays (n, 3) enter and leave the three slabs of a box, (n, 3) each."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (box[0] - eye) / rays, (box[1] - eye) / rays
    return np.fmin(first, second), np.fmax(first, second)
