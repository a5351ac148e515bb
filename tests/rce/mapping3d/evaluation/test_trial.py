from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.room import SimulatedRecording, sweep
from rce.mapping3d.evaluation.trial import ground_truth, run
from rce.mapping3d.files.trajectories import trajectory_text

WAY = sweep(0.2)


def test_ground_truth_of_both_formats_is_read(tmp_path: Path) -> None:
    assert ground_truth(tmp_path) == []
    for number, (_, pose) in enumerate(WAY):
        np.savetxt(tmp_path / f"frame-{number:06d}.pose.txt", pose)
    frames = ground_truth(tmp_path)
    (tmp_path / "groundtruth.txt").write_bytes(trajectory_text(WAY))
    for found in (frames, ground_truth(tmp_path)):
        np.testing.assert_allclose([pose for _, pose in found], [pose for _, pose in WAY], atol=1e-5)
        assert [stamp for stamp, _ in found] == pytest.approx([stamp for stamp, _ in WAY], abs=1e-6)


def test_damaged_ground_truth_is_named(tmp_path: Path) -> None:
    (tmp_path / "frame-000001.pose.txt").write_text("1 2 3\n")
    with pytest.raises(InvalidRequest, match=r"frame-000001\.pose\.txt is not a pose"):
        ground_truth(tmp_path)


@pytest.mark.slow
def test_trial_has_errors_and_costs() -> None:
    trial = run(SimulatedRecording("room", WAY), list(WAY))
    assert (trial.recording, trial.frames, trial.lost) == ("room", 6, 0)
    assert trial.absolute < 0.01
    assert trial.front_rate > 0
    assert trial.line_rate > 0
    assert np.isnan(run(SimulatedRecording("room", WAY), []).absolute)
