"""Error of a trajectory by relations between its poses."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.evaluation.trials import (
    error_of,
    read_relations,
    relations_of,
)
from rce.mapping.evaluation.trials.relations import MAX_RELATIONS, SAME_STAMP


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


def test_relations_of_a_long_trajectory_are_a_sample() -> None:
    truth = circle(6000, 30.0)
    relations = relations_of(truth)
    assert all(len(each.ends) <= MAX_RELATIONS for each in relations.values())
    again, other = relations_of(truth), relations_of(truth, seed=1)
    np.testing.assert_array_equal(relations["far"].ends, again["far"].ends)
    assert not np.array_equal(relations["far"].ends, other["far"].ends)


def test_relation_of_a_stamp_without_a_scan_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.relations"
    near, off = SAME_STAMP * 0.9, SAME_STAMP * 1.1
    path.write_text(f"{1 + near} {3 - near} 1 0 0 0 0 0\n{1 + off} 3 2 0 0 0 0 0\n")
    relations = read_relations(path, np.arange(10.0))
    assert relations.ends.tolist() == [[1, 3]]
    assert relations.motions.tolist() == [[1.0, 0.0, 0.0]]


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"none\.relations cannot be read"):
        read_relations(tmp_path / "none.relations", np.arange(10.0))
