from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("warp", reason="needs the extra `dense`")

from rce.errors import InvalidRequest
from rce.mapping3d.camera import Camera
from rce.mapping3d.dense.tracking import DenseTracker, DenseTrackingConfig
from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.evaluation.room import render, sweep

CAMERA = Camera(64, 48, 52.5, 52.5, 31.5, 23.5)
SMALL = DenseTrackingConfig(voxels=96, truncation=0.2, reach=0.3)


@pytest.mark.slow
def test_camera_is_tracked_against_the_surface_of_all_images_before() -> None:
    tracker, poses = DenseTracker(CAMERA, SMALL, "cpu"), []
    way = sweep(0.5)
    for _, pose in way:
        poses.append(tracker.add(render(pose, CAMERA)[1]))
        assert not tracker.lost
    error = absolute_error(poses, [pose for _, pose in way])
    assert error < 0.01
    standing = absolute_error([np.eye(4)] * len(way), [pose for _, pose in way])
    assert error < 0.2 * standing, "the camera has moved"
    before = tracker.pose
    tracker.add(np.zeros((48, 64), np.float32))
    assert tracker.lost
    np.testing.assert_array_equal(tracker.pose, before)


def test_image_of_another_camera_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="not of the camera"):
        DenseTracker(CAMERA, SMALL, "cpu").add(np.zeros((4, 4), np.float32))
