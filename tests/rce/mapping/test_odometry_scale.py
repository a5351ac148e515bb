from __future__ import annotations

import math

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.geometry import ORIGIN, Pose
from rce.mapping.odometry_scale import SETTINGS, OdometryScale
from rce.mapping.state import Reader, flatten

SURE = np.diag([1e-6, 1e-6, 1e-6])
VAGUE = np.diag([1.0, 1.0, 1e-4])


def driven(scale: OdometryScale, factor: float, steps: int, step: float = 1.0, start: float = 0.0) -> float:
    """Drive straight on; each step of the wheels is `step`, and the robot moves by `factor` of it. Return where."""
    for i in range(steps + 1):
        scale.observe(Pose(start + i * step, 0.0, 0.0), Pose(factor * (start + i * step), 0.0, 0.0), SURE)
    return start + steps * step


@pytest.mark.parametrize("factor", [0.9, 1.1])
@pytest.mark.parametrize("step", [1.0, 0.01], ids=["a metre", "a centimetre"])
def test_factor_is_found_after_fifty_metres(factor: float, step: float) -> None:
    scale = OdometryScale()
    driven(scale, factor, round(50 / step), step)
    assert scale.factor == pytest.approx(factor, abs=0.01)


def test_motion_is_corrected_and_keeps_its_turn() -> None:
    scale = OdometryScale()
    driven(scale, 0.9, 100)
    assert scale.correct(Pose(1.0, -0.5, 0.3)) == pytest.approx((0.9, -0.45, 0.3), abs=0.005)


def test_wheels_that_are_right_are_trusted() -> None:
    scale = OdometryScale()
    driven(scale, 1.0, 100)
    assert scale.correct(Pose(1.0, 0.0, 0.0)) == pytest.approx((1.0, 0.0, 0.0))


def test_heading_of_wheels_may_drift() -> None:
    """Only lengths are compared."""
    scale = OdometryScale()
    for i in range(100):
        turned = math.radians(i)
        wheels = Pose(math.cos(turned) * i, math.sin(turned) * i, turned)
        before = Pose(math.cos(turned - 0.01) * i, 0.0, 0.0)
        scale.interrupt()
        scale.observe(wheels, before, SURE)
        scale.observe(wheels @ Pose(1.0, 0.0, 0.0), before @ Pose(0.95, 0.0, 0.0), SURE)
    assert scale.factor == pytest.approx(0.95, abs=0.01)


@pytest.mark.parametrize("moved", [0.0, 2.0], ids=["stuck", "pushed"])
def test_slip_changes_nothing(moved: float) -> None:
    scale = OdometryScale()
    at = driven(scale, 1.0, 20)
    before = scale.factor
    scale.observe(Pose(at + 1.0, 0.0, 0.0), Pose(at + moved, 0.0, 0.0), SURE)
    assert scale.factor == before


def test_corridor_shows_little() -> None:
    """A match that does not fix the pose along the way must not teach the scale."""
    scale = OdometryScale()
    for i in range(20):
        scale.observe(Pose(1.0 * i, 0.0, 0.0), Pose(0.9 * i, 0.0, 0.0), VAGUE)
    assert scale.factor > 0.99


def test_interruption_forgets_the_step() -> None:
    scale = OdometryScale()
    scale.observe(ORIGIN, ORIGIN, SURE)
    scale.interrupt()
    scale.observe(Pose(1.0, 0.0, 0.0), Pose(0.9, 0.0, 0.0), SURE)
    assert scale.factor == 1.0


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_odometry_that_is_no_number_is_ignored(value: float) -> None:
    scale = OdometryScale()
    scale.observe(ORIGIN, ORIGIN, SURE)
    scale.observe(Pose(value, 0.0, 0.0), Pose(1.0, 0.0, 0.0), SURE)
    scale.observe(Pose(1.0, 0.0, 0.0), Pose(2.0, 0.0, 0.0), SURE)
    assert scale.factor == 1.0


def test_factor_follows_a_change_of_tyres() -> None:
    scale = OdometryScale()
    at = driven(scale, 1.0, 1000)
    scale.interrupt()
    driven(scale, 0.95, 1500, start=at)
    assert scale.factor == pytest.approx(0.95, abs=0.01)


def test_factor_stays_within_its_limits() -> None:
    scale = OdometryScale()
    for factor in np.arange(1.0, 0.3, -0.01):
        scale.interrupt()
        driven(scale, factor, 100)
    assert scale.factor == SETTINGS.limits[0]


def test_estimate_continues_after_it_was_saved() -> None:
    scale, again = OdometryScale(), OdometryScale()
    driven(scale, 0.9, 5)
    again.restore(Reader(dict(flatten(scale.state()))))
    for each in (scale, again):
        each.observe(Pose(6.0, 0.0, 0.0), Pose(5.4, 0.0, 0.0), SURE)
    assert (again.factor, again.variance) == (scale.factor, scale.variance)


@pytest.mark.parametrize("estimate", [[9.0, 0.01], [1.0, 0.0]], ids=["factor", "variance"])
def test_damaged_estimate_is_refused(estimate: list[float]) -> None:
    state = {"estimate": np.array(estimate), "start": np.empty((0, 3))}
    with pytest.raises(InvalidRequest, match="estimate is out of range"):
        OdometryScale().restore(Reader(state))
