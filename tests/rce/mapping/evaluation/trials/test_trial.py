"""Trial of a mapper on a recording."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.evaluation.trials import (
    Error,
    Odometry,
    Trial,
    relations_of,
    run,
)
from rce.mapping.grid import GridMap
from rce.mapping.pose_graph.mapper import GraphMapper


def test_trial_measures_a_run(simulation: Simulation) -> None:
    truth = relations_of(simulation.truth[:300])
    trial = run(GraphMapper, simulation.records[:300], Odometry(noise=0.1), truth)
    assert trial.scans == 300
    assert trial.cpu > 0
    assert trial.errors["near"].translation < 0.05
    assert trial.closed is None or trial.closed


def test_odometry_is_the_truth_unless_relations_are_given(simulation: Simulation) -> None:
    trial = run(GraphMapper, simulation.records[:60])
    assert set(trial.errors) == {"near", "far", "loop"}
    assert trial.errors["near"].relations > 0


def test_trial_without_truth_is_refused(simulation: Simulation) -> None:
    scans = [dataclasses.replace(scan, odometry=None) for scan in simulation.records[:3]]
    with pytest.raises(ValueError, match="0 of 3 scans have odometry"):
        run(GraphMapper, scans)


@pytest.mark.parametrize(
    ("errors", "closed"),
    [
        ({}, None),
        ({"loop": Error(math.nan, math.nan, math.nan, 0)}, None),
        ({"loop": Error(0.1, 0.0, 0.2, 9)}, True),
        ({"loop": Error(2.0, 0.0, 3.0, 9)}, False),
    ],
    ids=["unknown", "no loop", "closed", "open"],
)
def test_loop_is_closed_if_both_visits_coincide(errors: dict[str, Error], closed: bool | None) -> None:
    assert Trial(1, 0.0, errors, GridMap(0.05).render(), np.empty((0, 4))).closed == closed
