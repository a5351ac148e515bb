"""Localisation of a recording, measured."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from rce.mapping.evaluation.trials.localisation import errors_of, localise
from rce.mapping.localiser import Localiser

LOST, KNOWN = True, False


class Scripted:
    """Localiser that is lost or not as a script says, first before the first scan."""

    def __init__(self, *states: bool) -> None:
        self._states = list(states)

    @property
    def lost(self) -> bool:
        return self._states[0]

    def add(self, _scan: Any) -> None:
        del self._states[0]

    def trajectory(self) -> Any:
        return np.zeros((0, 4))


def localised(*states: bool) -> Any:
    scans = cast(Any, [SimpleNamespace()] * (len(states) - 1))
    return localise(cast(Localiser, Scripted(*states)), scans)


def test_first_pose_and_losses_are_counted() -> None:
    found = localised(LOST, LOST, KNOWN, KNOWN, LOST, KNOWN, LOST)
    assert (found.scans, found.first, found.losses) == (6, 1, 2)
    assert found.seconds is not None


def test_robot_that_is_never_found_has_no_first_pose() -> None:
    found = localised(LOST, LOST, LOST)
    assert (found.first, found.losses, found.seconds) == (None, 0, None)


def test_errors_are_those_at_the_same_stamps() -> None:
    truth = np.array([[1.0, 0, 0, 0], [2.0, 1, 0, math.pi - 0.1], [3.0, 2, 0, 0]])
    found = np.array([[2.0, 1.3, 0.4, -math.pi + 0.1]])
    assert errors_of(found, truth) == pytest.approx(np.array([[0.5, 0.2]]))
