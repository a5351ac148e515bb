from __future__ import annotations

import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.evaluation.room import QVGA
from rce.mapping3d.lidar.odometry import LidarTracker
from rce.mapping3d.odometry.tracker import Tracker
from rce.mapping3d.sensors import checked_sensor, front_end


def test_front_end_fits_the_sensor() -> None:
    assert isinstance(front_end(None), LidarTracker)
    tracker = front_end(Camera(640, 480, 525.0, 525.0, 319.5, 239.5))
    assert isinstance(tracker, Tracker)
    assert tracker.camera == QVGA, "the front end works on small images"


def test_unknown_sensor_is_refused() -> None:
    assert checked_sensor("lidar") == "lidar"
    with pytest.raises(InvalidRequest, match="no sensor 'sonar'; known: camera, lidar"):
        checked_sensor("sonar")
