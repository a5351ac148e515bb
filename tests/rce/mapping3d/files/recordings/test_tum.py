from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest, NotFound
from rce.mapping3d.files.recordings import open_recording
from tests.support.rgbd import CLEAN, simulated, write_tum

FRAMES = list(simulated(0.1, faults=CLEAN))
INTRINSICS = (262.5, 262.5, 159.5, 119.5)


def test_tum_directory_is_read(tmp_path: Path) -> None:
    recording = open_recording(write_tum(tmp_path / "desk", FRAMES), INTRINSICS)
    frames = list(recording)
    assert (recording.name, recording.frames, len(frames)) == ("desk", 3, 3)
    assert [frame.stamp for frame in frames] == pytest.approx([frame.stamp for frame in FRAMES], abs=1e-6)
    np.testing.assert_array_equal(frames[1].color, FRAMES[1].color)
    np.testing.assert_allclose(frames[1].depth, FRAMES[1].depth, atol=2e-4)


def test_depth_scale_can_be_given(tmp_path: Path) -> None:
    frame = next(iter(open_recording(write_tum(tmp_path / "desk", FRAMES), INTRINSICS, 10000.0)))
    np.testing.assert_allclose(frame.depth, FRAMES[0].depth / 2, atol=2e-4)


def test_published_calibration_of_a_known_camera_is_used(tmp_path: Path) -> None:
    recording = open_recording(write_tum(tmp_path / "rgbd_dataset_freiburg1_desk", FRAMES))
    assert recording.camera.fx == pytest.approx(517.3 / 2)


def test_colour_without_depth_is_left_out(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "desk", FRAMES)
    (path / "depth.txt").write_text("0.034 d1.png\n")
    assert [frame.stamp for frame in open_recording(path, INTRINSICS)] == pytest.approx([1 / 30], abs=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("rgb.txt", "abc\n", r"rgb\.txt, line 1"),
        ("rgb.txt", "0.0 ../../etc/passwd\n", "outside of the recording"),
        ("rgb.txt", "5.0 c0.png\n", "no stamp"),
        ("c0.png", "not an image", "not an image"),
    ],
)
def test_damaged_files_are_named(tmp_path: Path, name: str, content: str, reason: str) -> None:
    path = write_tum(tmp_path / "desk", FRAMES)
    (path / name).write_text(content)
    with pytest.raises(InvalidRequest, match=reason):
        list(open_recording(path, INTRINSICS))


def test_missing_list_is_named(tmp_path: Path) -> None:
    path = write_tum(tmp_path / "desk", FRAMES)
    (path / "depth.txt").unlink()
    with pytest.raises(InvalidRequest, match=r"no depth\.txt"):
        open_recording(path)


def test_other_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        open_recording(tmp_path / "none")
    with pytest.raises(InvalidRequest, match="not a recording"):
        open_recording(tmp_path)
