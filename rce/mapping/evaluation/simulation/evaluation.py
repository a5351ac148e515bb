"""Accuracy of a map and a trajectory against the ground truth of a simulation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from rce.mapping.evaluation.simulation.drive import Simulation
from rce.mapping.files.outputs import OCCUPIED
from rce.mapping.geometry import Pose, wrap_angles
from rce.mapping.grid import OccupancyGrid

NEAR = 0.1  # metres between a wall and its cells in the map at most


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Accuracy of a map and its trajectory.

    Attributes:
        translation: Mean absolute error of the positions after the best alignment, metres.
        rotation: Mean absolute error of the headings after the best alignment, radians.
        walls_found: Share of the points of walls seen that have an occupied cell within 0.1 m.
        walls_true: Share of the occupied cells that have a wall within 0.1 m; double walls lower it.
    """

    translation: float
    rotation: float
    walls_found: float
    walls_true: float


def evaluate(grid: OccupancyGrid, trajectory: NDArray[np.float64], simulation: Simulation) -> Accuracy:
    """Return the accuracy of a map and its trajectory.

    Args:
        grid: The map.
        trajectory: (n, 4) stamp, x, y, theta of each scan, map frame.
        simulation: The simulation that was mapped.

    Raises:
        ValueError: The trajectory has not one row for each scan.
    """
    truth = simulation.truth
    if trajectory.shape != truth.shape:
        raise ValueError(f"the trajectory has {len(trajectory)} poses, the simulation {len(truth)} scans")
    building = alignment(trajectory[:, 1:3], truth[:, 1:3])  # pose of the map frame in the frame of the building
    offset = building.transform(trajectory[:, 1:3]) - truth[:, 1:3]
    turn = wrap_angles(trajectory[:, 3] + building.theta - truth[:, 3])
    occupied = grid.cells >= 100 * OCCUPIED
    centres = grid.centres(occupied)
    return Accuracy(
        translation=float(np.hypot(offset[:, 0], offset[:, 1]).mean()),
        rotation=float(np.abs(turn).mean()),
        walls_found=_share_near(occupied, grid, building.inverse().transform(simulation.seen)),
        walls_true=float((simulation.plan.distance(building.transform(centres)) <= NEAR).mean())
        if len(centres)
        else 0.0,
    )


def alignment(points: NDArray[np.float64], targets: NDArray[np.float64]) -> Pose:
    """Return the pose that transforms points (n, 2) to targets (n, 2) with the least squared error (Umeyama, 1991)."""
    p, q = points - points.mean(axis=0), targets - targets.mean(axis=0)
    theta = math.atan2(float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()), float((p * q).sum()))
    x, y = (targets.mean(axis=0) - Pose(0.0, 0.0, theta).transform(points.mean(axis=0)[None])[0]).tolist()
    return Pose(x, y, theta)


def _share_near(occupied: NDArray[np.bool_], grid: OccupancyGrid, points: NDArray[np.float64]) -> float:
    """Return the share of points (n, 2), map frame, that are within NEAR of an occupied cell."""
    margin = math.ceil(NEAR / grid.resolution) + 1
    away = np.pad(~occupied, margin, constant_values=True).astype(np.uint8)
    distance = cv2.distanceTransform(away, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * grid.resolution
    cells = np.floor((points - np.array([grid.x, grid.y])) / grid.resolution).astype(np.int64) + margin
    inside = ((cells >= 0) & (cells < away.shape[::-1])).all(axis=1)
    near = distance[cells[inside, 1], cells[inside, 0]] <= NEAR
    return float(near.sum()) / max(len(points), 1)
