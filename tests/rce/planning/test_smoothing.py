"""Smoother paths."""

from __future__ import annotations

import math

import numpy as np

from rce.mapping.geometry import Pose
from rce.planning.astar import astar
from rce.planning.costmap import BLOCKED, Costmap
from rce.planning.search.deadline import Deadline
from rce.planning.smoothing import smooth, with_headings
from tests.support.planning import ROBOT, walled


def test_smooth_path_turns_less_and_stays_free() -> None:
    costmap = Costmap(walled(), ROBOT)
    points, _ = astar(costmap, Pose(2, 2, 0), Pose(8, 3, 0), 0.0, 2.0, Deadline(10))
    smoothed = smooth(costmap, points)
    assert (smoothed[[0, -1]] == points[[0, -1]]).all()

    def turns(path: np.ndarray) -> float:
        ahead = np.diff(path, axis=0)
        theta = np.arctan2(ahead[:, 1], ahead[:, 0])
        return float(np.abs((np.diff(theta) + np.pi) % (2 * np.pi) - np.pi).max())

    assert turns(smoothed) < turns(points)
    cells = np.floor((smoothed - costmap.corner) / costmap.resolution).astype(int)
    assert (costmap.costs[cells[:, 1], cells[:, 0]] < BLOCKED).all()


def test_poses_head_for_the_next_and_the_last_for_the_goal() -> None:
    poses = with_headings(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), 3.0)
    assert poses[:, 2].tolist() == [0.0, math.pi / 2, 3.0]
    assert poses[:, 3].tolist() == [1.0, 1.0, 1.0]
