"""Parts that differ between cameras with depth and lidars: front end, back end and dense map."""

from __future__ import annotations

from typing import Any, Protocol

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.frames import reduced_camera
from rce.mapping3d.odometry.tracker import Tracked, Tracker

CAMERA, LIDAR = "camera", "lidar"
SENSORS = (CAMERA, LIDAR)


class FrontEnd(Protocol):
    """`Tracker` or `LidarTracker`."""

    def add(self, frame: Any, /) -> Tracked:
        """Return the pose of the next frame, which is an `RgbdFrame` or a `Sweep`."""


def front_end(camera: Camera | None, robot: int = 0) -> FrontEnd:
    """Return the front end of a robot with this camera, or with a lidar if it is None."""
    if camera is not None:
        return Tracker(reduced_camera(camera), robot)
    from rce.mapping3d.lidar.odometry import LidarTracker  # robots with cameras need no kiss-icp

    return LidarTracker(robot)


def checked_sensor(name: str) -> str:
    """Return the name of a sensor.

    Raises:
        InvalidRequest: There is no such sensor.
    """
    if name not in SENSORS:
        raise InvalidRequest(f"there is no sensor {name!r}; known: {', '.join(SENSORS)}", field="sensor")
    return name
