from __future__ import annotations

import math

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.geometry import Pose
from rce.mapping.state import Reader, flatten
from rce.mapping.steps import SETTINGS, Steps

METRE, STILL = Pose(1.0, 0.0, 0.1), Pose(0.0, 0.0, 0.0)


def learned(*motions: Pose) -> Steps:
    steps = Steps()
    for motion in motions:
        steps.add(motion)
    return steps


def test_all_steps_cost_the_same_while_nothing_is_learned() -> None:
    assert Steps().cost(METRE) == Steps().cost(STILL) == Steps().cost(Pose(30.0, 0.0, 3.0)) > 0


def test_usual_step_costs_less_than_an_unusual_one() -> None:
    steps = learned(*[METRE] * 20)
    assert steps.cost(METRE) < steps.cost(Pose(0.8, 0.0, 0.1)) < steps.cost(STILL)
    assert steps.cost(Pose(0.0, 1.0, -0.1)) == pytest.approx(steps.cost(METRE)), "direction and side do not matter"


def test_cost_of_an_unusual_step_is_bounded() -> None:
    steps = learned(*[METRE] * SETTINGS.memory)
    assert steps.cost(STILL) == steps.cost(Pose(1e6, 0.0, 0.0)) == -SETTINGS.weight * math.log(SETTINGS.least)


def test_old_steps_are_forgotten() -> None:
    steps = learned(STILL, *[METRE] * SETTINGS.memory)
    assert steps.cost(STILL) == learned(*[METRE] * SETTINGS.memory).cost(STILL)


def test_restored_steps_are_the_same() -> None:
    steps, restored = learned(METRE, STILL), Steps()
    restored.restore(Reader(dict(flatten(steps.state()))))
    assert restored.cost(METRE) == steps.cost(METRE)
    with pytest.raises(InvalidRequest, match="steps"):
        restored.restore(Reader({"steps": np.zeros((2, 3))}))
