"""Shortest curves, against numerical checks."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares

from rce.planning.curves.kernels import (
    LEFT,
    RIGHT,
    STRAIGHT,
    Curve,
    drive,
    dubins,
    full_turn,
    half_turn,
    reeds_shepp,
    sample,
)

near = st.floats(-6, 6)
angles = st.floats(-math.pi, math.pi)
Find = Callable[[float, float, float], Curve]


def end_of(curve: Curve) -> tuple[float, float, float]:
    pose = 0.0, 0.0, 0.0
    for kind, length in curve.tolist():
        pose = drive(*pose, kind, length)
    return pose


def length_of(curve: Curve) -> float:
    return float(np.abs(curve[:, 1]).sum())


def offset(curve: Curve, x: float, y: float, theta: float) -> float:
    found = end_of(curve)
    return math.hypot(found[0] - x, found[1] - y) + abs(half_turn(found[2] - theta))


@pytest.mark.parametrize("find", [dubins, reeds_shepp])
@given(x=near, y=near, theta=angles)
@example(x=0.0, y=0.0, theta=0.0)
@example(x=0.0, y=0.0, theta=math.pi)
@example(x=4.0, y=0.0, theta=0.0)
@example(x=-1.0, y=0.0, theta=0.0)
def test_curve_ends_at_the_pose(find: Find, x: float, y: float, theta: float) -> None:
    assert offset(find(x, y, theta), x, y, theta) < 1e-5


@given(x=near, y=near, theta=angles)
def test_dubins_never_drives_in_reverse_and_reeds_shepp_is_never_longer(x: float, y: float, theta: float) -> None:
    curve = dubins(x, y, theta)
    assert (curve[:, 1] >= 0).all()
    assert length_of(reeds_shepp(x, y, theta)) <= length_of(curve) + 1e-6


@given(x=near, y=near, theta=angles)
def test_length_is_the_same_mirrored_and_from_goal_to_start(x: float, y: float, theta: float) -> None:
    length = length_of(reeds_shepp(x, y, theta))
    c, s = math.cos(theta), math.sin(theta)
    for other in ((x, -y, -theta), (-x, y, -theta), (-c * x - s * y, s * x - c * y, -theta)):
        assert math.isclose(length_of(reeds_shepp(*other)), length, abs_tol=1e-5)


Pose = tuple[float, float, float]
POSES: list[Pose] = [(0.4, 1.3, 2.0), (-1.0, 0.8, -2.5), (3.0, -2.0, 1.0)]
WORDS = [
    word
    for word in itertools.product((LEFT, STRAIGHT, RIGHT), repeat=3)
    if all(one != other for one, other in itertools.pairwise(word))
]


def fault_of(
    word: tuple[int, ...], senses: tuple[int, ...], pose: Pose
) -> Callable[[NDArray[np.float64]], list[float]]:
    """Return how far curves of a word end from a pose, as a function of the lengths of their segments."""

    def fault(lengths: NDArray[np.float64]) -> list[float]:
        found = end_of(np.array([*zip(word, np.array(senses) * np.abs(lengths), strict=True)], np.float64))
        return [found[0] - pose[0], found[1] - pose[1], half_turn(found[2] - pose[2])]

    return fault


def numeric(pose: Pose, signs: tuple[int, ...], firsts: Iterable[tuple[float, ...]]) -> float:
    """Return the length of the shortest curve of three segments, whose lengths are solved for from starting points."""
    best = math.inf
    for word, senses, first in itertools.product(WORDS, itertools.product(signs, repeat=3), list(firsts)):

        def fault(
            lengths: NDArray[np.float64], word: tuple[int, ...] = word, senses: tuple[int, ...] = senses
        ) -> list[float]:
            curve = np.array([*zip(word, np.array(senses) * np.abs(lengths), strict=True)], np.float64)
            found = end_of(curve)
            return [found[0] - pose[0], found[1] - pose[1], half_turn(found[2] - pose[2])]

        solved = least_squares(fault, first, max_nfev=30)
        if solved.cost < 1e-12:
            best = min(best, float(np.abs(solved.x).sum()))
    return best


@pytest.mark.slow
@pytest.mark.parametrize("pose", POSES[:1])
def test_dubins_is_the_shortest_of_all_words(pose: Pose) -> None:
    best = numeric(pose, (1,), itertools.product((0.5, 2.5, 4.6), repeat=3))
    assert math.isclose(length_of(dubins(*pose)), best, abs_tol=1e-5)


@pytest.mark.parametrize("pose", POSES[1:2])
def test_no_word_of_three_segments_is_shorter_than_reeds_shepp(pose: Pose) -> None:
    best = numeric(pose, (1, -1), [(0.3, 0.3, 0.3), (1.5, 1.0, 1.5)])
    assert length_of(reeds_shepp(*pose)) <= best + 1e-5


def test_samples_are_close_together_and_end_at_the_goal() -> None:
    curve = reeds_shepp(-1.0, 0.8, -2.5)
    poses = sample(curve, 0.0, 0.0, 0.0, 2.0, 0.1)
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert steps.max() <= 0.1 + 1e-9
    assert np.allclose(poses[-1, :2], (-2.0, 1.6))
    assert math.isclose(half_turn(poses[-1, 2] + 2.5), 0.0, abs_tol=1e-6)
    assert set(poses[:, 3]) <= {1.0, -1.0}
    bends = np.abs(np.diff(poses[:, 2]))
    assert (bends <= steps / 2.0 * 1.01 + 1e-9).all()


def test_angles_are_in_their_ranges() -> None:
    assert full_turn(-1e-12) == 0.0
    assert math.isclose(full_turn(-1.0), 2 * math.pi - 1)
    assert math.isclose(half_turn(4.0), 4.0 - 2 * math.pi)
