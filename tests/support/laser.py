"""Measurements of a laser in the simulated apartment, or in another floor plan."""

from __future__ import annotations

import math

import numpy as np

from rce.mapping.evaluation.simulation.floor_plan import FloorPlan, apartment
from rce.mapping.geometry import Points, Pose
from rce.mapping.pose_graph.graph import Sweep
from rce.mapping.scans import Scan

PLACE = Pose(2.6, 3.4, 0.3)  # in the first room of the apartment
SENSOR = np.zeros((1, 2))  # a laser at the origin of the robot
RANGE_MAX = 12.0  # metres


def points_at(pose: Pose, plan: FloorPlan | None = None, beams: int = 360, noise: float = 0.0, seed: int = 0) -> Points:
    """Return the points (n, 2), frame of the robot, that a laser at `pose` sees all around at any distance."""
    ranges = (plan or apartment()).ranges(*pose, beams, 2 * math.pi)
    if noise:
        ranges = ranges + np.random.default_rng(seed).normal(0.0, noise, beams)
    angles = -math.pi + np.arange(beams) * 2 * math.pi / beams
    return np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1)


def scan_at(
    pose: Pose, plan: FloorPlan | None = None, beams: int = 360, stamp: float = 0.0, odometry: Pose | None = None
) -> Scan:
    """Return the scan of a laser of 12 m at `pose`."""
    ranges = (plan or apartment()).ranges(*pose, beams, 2 * math.pi).astype(np.float32)
    return Scan(stamp, ranges, -math.pi, 2 * math.pi / beams, RANGE_MAX, odometry)


def sweep_at(pose: Pose, plan: FloorPlan | None = None, beams: int = 360) -> Sweep:
    """Return what a node at `pose` keeps of its scan."""
    return Sweep(SENSOR, scan_at(pose, plan, beams).points(RANGE_MAX).astype(np.float32))
