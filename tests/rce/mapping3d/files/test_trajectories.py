from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest, NotFound
from rce.mapping3d.evaluation.room import sweep
from rce.mapping3d.files.trajectories import nearest_stamps, read_trajectory, trajectory_text


def test_trajectory_is_the_same_after_a_round_trip(tmp_path: Path) -> None:
    way = sweep(0.2)
    path = tmp_path / "trajectory.txt"
    path.write_bytes(b"# timestamp tx ty tz qx qy qz qw\n" + trajectory_text(way))
    again = read_trajectory(path)
    assert [stamp for stamp, _ in again] == pytest.approx([stamp for stamp, _ in way], abs=1e-6)
    np.testing.assert_allclose([pose for _, pose in again], [pose for _, pose in way], atol=1e-5)


@pytest.mark.parametrize("line", ["1 2 3", "a b c d e f g h", "1 0 0 0 0 0 0 0", "nan 0 0 0 0 0 0 1"])
def test_damaged_line_is_named(tmp_path: Path, line: str) -> None:
    (tmp_path / "t.txt").write_text(f"0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(InvalidRequest, match=r"t\.txt, line 2"):
        read_trajectory(tmp_path / "t.txt")


def test_missing_and_empty_trajectories_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        read_trajectory(tmp_path / "none.txt")
    (tmp_path / "t.txt").write_text("# nothing\n")
    with pytest.raises(InvalidRequest, match="no poses"):
        read_trajectory(tmp_path / "t.txt")


def test_stamps_are_paired_with_the_nearest_once() -> None:
    assert nearest_stamps([0.0, 0.03, 1.0], [0.001, 0.02, 0.031, 0.5]) == [(0, 0), (1, 2)]
    assert nearest_stamps([], [1.0]) == []
