from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.evaluation.trials import (
    Odometry,
    endless,
    error_of,
    flatness,
    read_relations,
    relations_of,
    run,
    with_odometry,
)
from rce.mapping.evaluation.trials.endless import back_and_forth
from rce.mapping.pose_graph.mapper import GraphMapper


def circle(count: int = 400, turns: float = 2.0) -> np.ndarray:
    angle = np.linspace(0.0, 2 * math.pi * turns, count)
    x, y = 10 * np.sin(angle), 10 - 10 * np.cos(angle)
    return np.stack([np.arange(count), x, y, (angle + np.pi) % (2 * np.pi) - np.pi], axis=1)


def test_trajectory_in_another_frame_has_no_error() -> None:
    truth = circle()
    moved = truth.copy()
    moved[:, 1:3] = truth[:, 1:3] @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + 5.0
    moved[:, 3] += math.pi / 2
    for kind, relations in relations_of(truth).items():
        error = error_of(moved, relations)
        assert error.relations > 100, kind
        assert max(error.translation, error.rotation, error.worst) < 1e-9


def test_open_loop_is_visible_only_over_long_distances() -> None:
    truth = circle()
    drifted = truth.copy()
    drifted[:, 1] += np.linspace(0.0, 2.0, len(truth))
    errors = {kind: error_of(drifted, each) for kind, each in relations_of(truth).items()}
    assert errors["near"].translation < 0.05
    assert errors["loop"].translation == pytest.approx(1.0, abs=0.1)
    assert errors["far"].translation > 0.4


def test_there_is_no_loop_without_a_second_visit() -> None:
    errors = relations_of(circle(turns=0.5))
    assert math.isnan(error_of(circle(turns=0.5), errors["loop"]).translation)


def test_relations_are_read_from_a_file(tmp_path: Path) -> None:
    truth = circle()
    path = tmp_path / "a.relations"
    path.write_text("0.01 100.0 1 2 0 0 0 0.5\n3.5 7 0 0 0 0 0 0\n")
    relations = read_relations(path, truth[:, 0])
    assert relations.ends.tolist() == [[0, 100]]
    assert relations.motions.tolist() == [[1.0, 2.0, 0.5]]


@pytest.mark.parametrize(
    ("text", "reason"), [("1 2 3\n", "8 numbers"), ("a b\n", "cannot be read"), ("1e9 1e9 0 0 0 0 0 0\n", "two scans")]
)
def test_files_of_other_formats_are_rejected(tmp_path: Path, text: str, reason: str) -> None:
    path = tmp_path / "a.relations"
    path.write_text(text)
    with pytest.raises(InvalidRequest, match=reason):
        read_relations(path, np.arange(10.0))


def test_same_seed_degrades_odometry_alike(simulation: Simulation) -> None:
    scans = simulation.records[:100]

    def way(odometry: Odometry) -> float:
        poses = np.array([scan.odometry for scan in with_odometry(scans, odometry)])
        return float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())

    assert way(Odometry(scale=1.1)) == pytest.approx(1.1 * way(Odometry()))
    assert way(Odometry(slip=1.0, slip_every=50)) > way(Odometry()) + 0.9
    noisy = [[scan.odometry for scan in with_odometry(scans, Odometry(noise=0.1), seed)] for seed in (0, 0, 1)]
    assert noisy[0] == noisy[1] != noisy[2]
    assert {scan.odometry for scan in with_odometry(scans, Odometry(none=True))} == {None}


def test_trial_measures_a_run(simulation: Simulation) -> None:
    truth = relations_of(simulation.truth[:300])
    trial = run(GraphMapper, simulation.records[:300], Odometry(noise=0.1), truth)
    assert trial.scans == 300
    assert trial.cpu > 0
    assert trial.errors["near"].translation < 0.05
    assert trial.closed is None or trial.closed


def test_endless_run_does_not_jump_and_is_measured(simulation: Simulation) -> None:
    scans = simulation.records[:50]
    stream = list(back_and_forth(scans, 160))
    assert np.diff([scan.stamp for scan in stream]) == pytest.approx(0.1)
    jumps = [a.odometry.to(b.odometry) for a, b in pairwise(stream) if a.odometry and b.odometry]
    assert max(math.hypot(jump.x, jump.y) for jump in jumps) < 0.2
    measured = endless(GraphMapper, scans, 200)
    assert len(measured.scans) == 100
    assert flatness(measured.memory) < 1.2
    assert (measured.seconds >= 0).all()
