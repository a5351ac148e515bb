from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping3d.files.recordings import open_recording
from rce.mapping3d.files.recordings.seven_scenes import SevenScenes
from tests.support.paths import DATA
from tests.support.rgbd import CLEAN, simulated, write_seven_scenes

FRAMES = list(simulated(0.1, faults=CLEAN))
RECORDED = DATA / "rgbd-7scenes"


def test_directory_is_read_with_stamps_by_number(tmp_path: Path) -> None:
    path = write_seven_scenes(tmp_path / "office", FRAMES)
    (path / "frame-000001.depth.png").unlink()
    recording = open_recording(path)
    frames = list(recording)
    assert recording.camera.fx == 262.5
    assert [frame.stamp for frame in frames] == pytest.approx([0.0, 2 / 30])
    np.testing.assert_array_equal(frames[1].color, FRAMES[2].color)
    np.testing.assert_allclose(frames[1].depth, FRAMES[2].depth, atol=1.1e-3)


def test_missing_intrinsics_are_asked_for(tmp_path: Path) -> None:
    path = write_seven_scenes(tmp_path / "office", FRAMES)
    (path / "camera-intrinsics.txt").write_text("585 0\n")
    with pytest.raises(InvalidRequest, match="not a matrix"):
        open_recording(path)
    (path / "camera-intrinsics.txt").unlink()
    with pytest.raises(InvalidRequest, match="--camera"):
        open_recording(path)
    assert open_recording(path, (200.0, 200.0, 160.0, 120.0)).camera.fx == 200.0


def test_image_of_another_size_is_refused(tmp_path: Path) -> None:
    path = write_seven_scenes(tmp_path / "office", FRAMES)
    (path / "frame-000001.color.png").write_bytes((path / "frame-000000.depth.png").read_bytes())
    small = write_seven_scenes(tmp_path / "small", [frame.halved() for frame in FRAMES])
    (path / "frame-000001.depth.png").write_bytes((small / "frame-000001.depth.png").read_bytes())
    with pytest.raises(InvalidRequest, match="160 x 120"):
        list(open_recording(path))


def test_colours_of_a_registered_camera_are_left_as_they_are(tmp_path: Path) -> None:
    # The intrinsics are those of a Kinect's depths, but the edges agree already.
    path = write_seven_scenes(tmp_path / "office", FRAMES)
    assert SevenScenes(path, (292.5, 292.5, 160.0, 120.0), None).color is None


@pytest.mark.skipif(not RECORDED.exists(), reason=f"no recorded data in {RECORDED}")
def test_separate_colour_camera_of_a_recorded_run_is_found() -> None:
    assert SevenScenes(RECORDED, None, None).color is not None
