"""Lengths and turns of the steps between scans, learned on the way."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from rce.mapping.geometry import Pose
from rce.mapping.state import Reader, State


@dataclass(frozen=True, slots=True)
class StepSettings:
    """Settings of the steps.

    Attributes:
        memory: Steps that are remembered, the last ones.
        length: Metres; standard deviation of the kernel around a step.
        turn: Radians; the same for the turn.
        unknown: Number of remembered steps that weigh as much as knowing nothing.
        background: Density of any step, if nothing is known, as a share of that of a step that always is the same.
        least: Density below which steps are equally unlikely.
        weight: Cost, in mean likelihood of a scan, of a density that is smaller by the factor e.
    """

    memory: int = 200
    length: float = 0.1
    turn: float = math.radians(6)
    unknown: int = 5
    background: float = 0.05
    least: float = 0.02
    weight: float = 0.08


SETTINGS = StepSettings()


class Steps:
    """Density of the steps of a recording (kernel density estimate: Parzen, 1962).

    Robots record scans by a rule, often one after each metre or 30 degrees. Where a corridor looks the same everywhere,
    a scan fits the place of the last one best, and only such a rule tells that the robot has moved.
    """

    def __init__(self) -> None:
        """Know nothing."""
        self._steps: deque[tuple[float, float]] = deque(maxlen=SETTINGS.memory)

    def add(self, motion: Pose) -> None:
        """Learn the motion between two scans."""
        self._steps.append(_length_and_turn(motion))

    def cost(self, motion: Pose) -> float:
        """Return the penalty of a motion between two scans, in mean likelihood of a scan."""
        length, turn = _length_and_turn(motion)
        known = np.array(self._steps, np.float64).reshape(-1, 2)
        off = ((known[:, 0] - length) / SETTINGS.length) ** 2 + ((known[:, 1] - turn) / SETTINGS.turn) ** 2
        density = np.exp(-0.5 * off).sum() + SETTINGS.unknown * SETTINGS.background
        return -SETTINGS.weight * math.log(max(density / (len(known) + SETTINGS.unknown), SETTINGS.least))

    def state(self) -> State:
        """Return the steps as arrays to save."""
        return {"steps": np.array(self._steps, np.float64).reshape(-1, 2)}

    def restore(self, saved: Reader) -> None:
        """Replace the steps by saved ones.

        Raises:
            InvalidRequest: The saved arrays are not steps.
        """
        self._steps = deque(map(tuple, saved.array("steps", np.float64, None, 2).tolist()), SETTINGS.memory)


def _length_and_turn(motion: Pose) -> tuple[float, float]:
    return math.hypot(motion.x, motion.y), abs(motion.theta)
