from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.errors import absolute_error, rigid_alignment, trajectory_error
from rce.mapping3d.evaluation.room import sweep
from rce.mapping3d.poses import make_pose, transform

WAY = sweep(2.0)
ELSEWHERE = make_pose(Rotation.from_rotvec((0.4, 1.0, -2.0)).as_matrix(), (3.0, 2.0, 1.0))


def test_same_way_in_another_frame_has_no_error() -> None:
    error = trajectory_error([(stamp, ELSEWHERE @ pose) for stamp, pose in WAY], WAY)
    assert (error.poses, error.absolute) == (60, pytest.approx(0.0, abs=1e-9))
    assert error.drift == pytest.approx(0.0, abs=1e-9)


def test_absolute_error_is_the_root_mean_square_of_distances() -> None:
    truth = [make_pose(np.eye(3), place) for place in ((0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0))]
    off = [pose @ make_pose(np.eye(3), (0, 0, d)) for pose, d in zip(truth, (0.1, -0.1, 0.1, -0.1), strict=True)]
    assert absolute_error(off, truth) == pytest.approx(0.1, rel=1e-3)


def test_relative_error_is_the_drift_of_a_second() -> None:
    drifting = [(stamp, make_pose(np.eye(3), (0.05 * stamp, 0, 0))) for stamp, _ in WAY]
    still = [(stamp, np.eye(4)) for stamp, _ in WAY]
    error = trajectory_error(drifting, still)
    assert error.drift == pytest.approx(0.05, rel=1e-6)
    assert math.isnan(trajectory_error(drifting[:5], still[:5]).drift)


def test_alignment_of_points_is_found() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    np.testing.assert_allclose(rigid_alignment(points, transform(ELSEWHERE, points)), ELSEWHERE, atol=1e-9)


def test_trajectories_without_common_stamps_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="fewer than three"):
        trajectory_error(WAY, [(stamp + 100.0, pose) for stamp, pose in WAY])
