from __future__ import annotations

import math

import numpy as np
import pytest

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.history import History


def history(count: int) -> History:
    history = History()
    for i in range(count):
        history.append(float(i), i % 2, Pose(0.1 * i, 0.0, 0.0))
    return history


def test_poses_follow_their_nodes() -> None:
    rows = history(3000).trajectory(np.array([ORIGIN, Pose(1.0, 2.0, math.pi / 2)]))
    assert rows.shape == (3000, 4)
    np.testing.assert_allclose(rows[2], [2.0, 0.2, 0.0, 0.0])
    np.testing.assert_allclose(rows[2999], [2999.0, 1.0, 301.9, math.pi / 2])


@pytest.mark.parametrize(("stamp", "row"), [(-5.0, 0), (0.0, 0), (1.5, 1), (9.0, 9), (99.0, 9)])
def test_last_scan_before_a_stamp_is_found(stamp: float, row: int) -> None:
    node, pose = history(10).at(stamp)
    assert node == row % 2
    assert pose == pytest.approx(Pose(0.1 * row, 0.0, 0.0))


def test_empty_history_has_no_trajectory() -> None:
    assert History().trajectory(np.array([ORIGIN])).shape == (0, 4)
