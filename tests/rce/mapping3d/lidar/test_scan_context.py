from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rce.mapping3d.evaluation.building import ROUND, SimulatedSweeps, patrol, spinning
from rce.mapping3d.lidar.registration import Surface
from rce.mapping3d.lidar.scan_context import ContextIndex, descriptor
from rce.mapping3d.poses import Floats, make_pose, transform


def seen(metres: float) -> Floats:
    """Return what a lidar sees that stands on the way through the building."""
    stamp, pose = patrol(ROUND, 0.0, begin=metres)[0]
    (sweep,) = SimulatedSweeps("", ((stamp, pose), (stamp + 0.1, pose)), spinning(32, 720))
    return sweep.points.astype(np.float64)


def test_place_is_recognised_from_another_heading() -> None:
    index = ContextIndex()
    for number, metres in enumerate((2.0, 14.0, 26.0, 40.0)):
        index.add(number, descriptor(Surface(seen(metres))))
    assert len(index) == 4
    turn = math.radians(120)
    turned = transform(make_pose(Rotation.from_euler("z", -turn).as_matrix(), (0, 0, 0)), seen(14.3))
    (best, similarity, yaw), *others = index.query(descriptor(Surface(turned)))
    assert best == 1
    assert yaw == pytest.approx(turn, abs=math.radians(7))
    assert similarity > 0.9 > max(each[1] for each in others)


def test_empty_index_knows_no_place() -> None:
    nothing = descriptor(Surface(np.empty((0, 3))))
    assert not nothing.any()
    assert ContextIndex().query(nothing) == []
