from __future__ import annotations

import numpy as np

from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.particles.filter import ParticleFilter

CORNER = np.array([[2.0, 0.01 * i] for i in range(100)] + [[0.01 * i, 1.0] for i in range(200)])


def filter_of(count: int) -> ParticleFilter:
    found = ParticleFilter(count, seed=0)
    found.learn(CORNER)
    return found


def test_particles_follow_both_hypotheses_of_a_motion() -> None:
    found = filter_of(4)
    there = CORNER - np.array([0.8, 0.0])
    found.move(ORIGIN, np.diag([1e-4, 1e-4, 1e-5]), there, other=Pose(0.8, 0.0, 0.0))
    np.testing.assert_allclose(found.poses[1::2], np.tile([0.8, 0.0, 0.0], (2, 1)), atol=0.1)
    assert found.log_weights[::2].max() < -2.0 < found.log_weights[1::2].min()


def test_likely_particles_replace_unlikely_ones() -> None:
    found = filter_of(4)
    found.poses = np.array([[0.6, 0.6, 0.3], [0.0, 0.0, 0.0], [0.5, -0.6, -0.3], [-0.6, 0.6, 0.3]])
    found.move(ORIGIN, np.diag([1e-4, 1e-4, 1e-5]), CORNER)
    assert found.best == 1
    assert np.sort(found.log_weights)[-2] < -3.0
    found.resample()
    assert np.hypot(*found.poses[:, :2].T).max() < 0.1
    assert (found.log_weights == 0.0).all()


def test_equally_likely_particles_stay_diverse() -> None:
    """Otherwise all descend from one ancestor a few steps ago, and have the same error where a loop closes."""
    found = filter_of(30)
    for _ in range(40):
        found.move(ORIGIN, np.diag([1e-3, 1e-3, 1e-4]), CORNER)
        found.learn(CORNER)
        found.resample()
    ancestors = {tuple(pose) for pose in found.paths.branches[:, 0].tolist()}
    assert not len(found.paths.stem)
    assert len(ancestors) > 10
