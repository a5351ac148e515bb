from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.evaluation.room import SimulatedRecording, sweep
from rce.mapping3d.files.recordings.seven_scenes import SevenScenes
from rce.mapping3d.files.trajectories import read_trajectory
from rce.mapping3d.frames import RgbdFrame
from rce.mapping3d.pipeline import Mapping
from tests.support.paths import DATA
from tests.support.rgbd import CLEAN

RECORDED = DATA / "rgbd-7scenes"


@pytest.mark.slow
def test_two_robots_are_written_in_one_frame(tmp_path: Path) -> None:
    ways = [sweep(0.5, 2.0), sweep(0.5, 2.0, begin=0.5)]
    mapping = Mapping([SimulatedRecording(f"robot {k}", way, CLEAN) for k, way in enumerate(ways)])
    counts: list[int] = []
    mapping.run(counts.append)
    assert counts == list(range(1, 31))
    assert mapping.write(tmp_path) == [(tmp_path, [0, 1])]
    paths = [read_trajectory(tmp_path / f"trajectory-{number}.txt") for number in (1, 2)]
    np.testing.assert_allclose(paths[0][0][1], np.eye(4), atol=1e-6)
    assert [len(path) for path in paths] == [15, 15]
    estimate = [pose for path in paths for _, pose in path]
    assert absolute_error(estimate, [pose for way in ways for _, pose in way]) < 0.01
    for name in ("cloud.ply", "mesh.ply", "map.pgm", "map.yaml", "view.png"):
        assert (tmp_path / name).stat().st_size > 0
    mapping.mapper.close()


def test_recording_without_depth_is_refused() -> None:
    class Blind(SimulatedRecording):
        def __iter__(self):  # type: ignore[no-untyped-def]
            for stamp, _ in self.way:
                yield RgbdFrame(stamp, np.zeros((240, 320, 3), np.uint8), np.zeros((240, 320), np.float32))

    with pytest.raises(InvalidRequest, match="no frame with enough depth"):
        Mapping([Blind("dark", sweep(0.1))]).run()


@pytest.mark.slow
@pytest.mark.skipif(not RECORDED.exists(), reason=f"no recorded data in {RECORDED}")
def test_beginning_of_a_recorded_run_is_followed_to_8_millimetres() -> None:
    class Beginning(SevenScenes):
        def __iter__(self):  # type: ignore[no-untyped-def]
            for number, color in self._colors[:60:2]:
                yield self._frame(number, color)

    mapping = Mapping([Beginning(RECORDED, None, None)])
    mapping.run()
    truth = [np.loadtxt(RECORDED / f"frame-{number:06d}.pose.txt") for number in range(0, 60, 2)]
    assert absolute_error([pose for _, pose in mapping.trajectory(0)], truth) < 0.008
    mapping.mapper.close()
