"""Errors of trajectories (Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems, 2012)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping3d.files.trajectories import Stamped, nearest_stamps
from rce.mapping3d.poses import Pose, angle, distance, inverse, make_pose, transform

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TrajectoryError:
    """Errors of a trajectory.

    Attributes:
        poses: Number of poses that were compared.
        absolute: Absolute trajectory error, metres, root mean square.
        drift: Relative pose error over one second, metres, root mean square.
        turn: The same of the rotation, radians.
    """

    poses: int
    absolute: float
    drift: float
    turn: float


def trajectory_error(estimate: Sequence[Stamped], truth: Sequence[Stamped], interval: float = 1.0) -> TrajectoryError:
    """Return the errors of a trajectory; stamps within 0.02 s belong together.

    Args:
        estimate: Poses in order of time, in any frame.
        truth: Poses in order of time.
        interval: Seconds over which the relative error is taken.

    Raises:
        InvalidRequest: Fewer than three stamps agree.
    """
    pairs = nearest_stamps([stamp for stamp, _ in estimate], [stamp for stamp, _ in truth])
    if len(pairs) < 3:
        raise InvalidRequest("the trajectory and the ground truth have fewer than three stamps within 0.02 s")
    stamps = [estimate[i][0] for i, _ in pairs]
    first = [estimate[i][1] for i, _ in pairs]
    second = [truth[k][1] for _, k in pairs]
    drift, turn = _relative(stamps, first, second, interval)
    return TrajectoryError(len(pairs), absolute_error(first, second), drift, turn)


def absolute_error(estimate: Sequence[Pose], truth: Sequence[Pose]) -> float:
    """Return the root mean square of the distances after the best rigid alignment, metres."""
    moving, fixed = np.array([pose[:3, 3] for pose in estimate]), np.array([pose[:3, 3] for pose in truth])
    moved = transform(rigid_alignment(moving, fixed), moving)
    return float(np.sqrt(np.mean(np.sum((moved - fixed) ** 2, axis=1))))


def rigid_alignment(moving: Floats, fixed: Floats) -> Pose:
    """Return the pose that moves points (n, 3) as near as possible to others (n, 3).

    Method of Horn, solved by singular values (Umeyama, Least-Squares Estimation of Transformation Parameters Between
    Two Point Patterns, 1991), without scale.
    """
    centre, target = moving.mean(axis=0), fixed.mean(axis=0)
    left, _, right = np.linalg.svd((fixed - target).T @ (moving - centre))
    mirrored = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    rotation = left @ mirrored @ right
    return make_pose(rotation, target - rotation @ centre)


def _relative(
    stamps: Sequence[float], first: Sequence[Pose], second: Sequence[Pose], interval: float
) -> tuple[float, float]:
    """Return the root mean squares of the relative errors over an interval; NaN if the trajectory is shorter."""
    shifts, turns = [], []
    later = np.searchsorted(np.asarray(stamps), np.asarray(stamps) + interval - 1e-6)
    for i, k in enumerate(later.tolist()):
        if k >= len(stamps):
            break
        error = inverse(inverse(second[i]) @ second[k]) @ inverse(first[i]) @ first[k]
        shifts.append(distance(error) ** 2)
        turns.append(angle(error) ** 2)
    if not shifts:
        return math.nan, math.nan
    return math.sqrt(float(np.mean(shifts))), math.sqrt(float(np.mean(turns)))
