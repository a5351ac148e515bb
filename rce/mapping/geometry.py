"""Poses in the plane, SE(2), and operations on arrays of points and poses."""

from __future__ import annotations

import math
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]  # (n, 2), metres
Cell = TypeVar("Cell", bound=np.generic)


def wrap_angle(angle: float) -> float:
    """Return the equivalent angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def wrap_angles(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the equivalent angles in [-pi, pi)."""
    wrapped: NDArray[np.float64] = (angles + np.pi) % (2 * np.pi) - np.pi
    return wrapped


class Pose(NamedTuple):
    """Pose in the plane, or the motion between two poses.

    Attributes:
        x: Metres, forward.
        y: Metres, to the left.
        theta: Heading in radians, counter-clockwise.
    """

    x: float
    y: float
    theta: float

    def __matmul__(self, other: Pose) -> Pose:
        """Compose two poses: return `other`, given in the frame of `self`, in the frame in which `self` is given."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose(
            self.x + c * other.x - s * other.y, self.y + s * other.x + c * other.y, wrap_angle(self.theta + other.theta)
        )

    def inverse(self) -> Pose:
        """Return the pose whose composition with this one is the origin."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        return Pose(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.theta))

    def to(self, other: Pose) -> Pose:
        """Return the motion from this pose to `other`, in the frame of this pose."""
        return self.inverse() @ other

    def transform(self, points: Points) -> Points:
        """Return points (n, 2) of the frame of this pose in the frame in which this pose is given."""
        c, s = math.cos(self.theta), math.sin(self.theta)
        moved: Points = points @ np.array([[c, s], [-s, c]]) + np.array([self.x, self.y])
        return moved

    def exceeds(self, distance: float, angle: float) -> bool:
        """Return whether this motion (see `to`) is longer than `distance` or turns by more than `angle`."""
        return math.hypot(self.x, self.y) > distance or abs(self.theta) > angle


ORIGIN = Pose(0.0, 0.0, 0.0)


def interpolate(before: Pose, after: Pose, share: float) -> Pose:
    """Return the pose at `share` (0..1) of the way between two poses, turning the shorter way round."""
    turn = wrap_angle(after.theta - before.theta)
    return Pose(
        before.x + share * (after.x - before.x),
        before.y + share * (after.y - before.y),
        wrap_angle(before.theta + share * turn),
    )


def trajectory_of_offset(trajectory: NDArray[np.float64], offset: Pose) -> NDArray[np.float64]:
    """Return the trajectory of a frame mounted at `offset` on a robot.

    Args:
        trajectory: (n, 4) stamp, x, y, theta of the robot.
        offset: Pose of the mounted frame in the frame of the robot.

    Returns:
        (n, 4) stamp, x, y, theta of the mounted frame, in the frame of `trajectory`.
    """
    stamps, x, y, theta = trajectory.T
    c, s = np.cos(theta), np.sin(theta)
    turned = wrap_angles(theta + offset.theta)
    return np.stack([stamps, x + c * offset.x - s * offset.y, y + s * offset.x + c * offset.y, turned], axis=1)


def round_up_to_blocks(missing: NDArray[np.int64], block: int) -> NDArray[np.int64]:
    """Round numbers of missing cells up to whole blocks of `block` cells; negative numbers become 0."""
    return np.maximum(-(-missing // block), 0) * block


def sample_cells(cells: NDArray[Cell], places: Points, outside: int) -> NDArray[Cell]:
    """Return the cells (n,) of a grid at `places` (n, 2: column, row, rounded down), `outside` beyond its edges."""
    column, row = np.floor(places).astype(np.int64).T
    height, width = cells.shape
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    found = cells[row.clip(0, height - 1), column.clip(0, width - 1)]
    return np.where(inside, found, np.asarray(outside, cells.dtype))
