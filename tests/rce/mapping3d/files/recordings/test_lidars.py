from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.clouds import Sweep
from rce.mapping.files.recordings import open_recording as open_scans
from rce.mapping3d.files.recordings import camera_of, open_recording
from rce.mapping3d.files.recordings.lidars import LidarBag
from tests.support.sweeps import bag_of_sweeps

POINTS = np.array([[1, 2, 0], [-4, 5, 0.1], [7, 8, -9]], np.float32)
SWEEPS = [Sweep(stamp, POINTS, np.array([0.0, 0.02, 0.09])) for stamp in (1.0, 1.1, 1.25)]


def test_sweeps_of_a_bag_come_in_order_with_their_times(tmp_path: Path) -> None:
    recording = open_recording(bag_of_sweeps(tmp_path / "bag", SWEEPS))
    assert isinstance(recording, LidarBag)
    assert camera_of(recording) is None
    assert (recording.name, recording.frames, recording.topic) == ("bag", 3, "/points")
    sweeps = list(recording)
    assert [each.stamp for each in sweeps] == pytest.approx([1.0, 1.1, 1.25])
    assert sweeps[0].points.tolist() == POINTS.tolist()
    assert sweeps[0].times.tolist() == pytest.approx([0.0, 0.02, 0.09])


def test_one_of_several_lidars_must_be_chosen(tmp_path: Path) -> None:
    bag = bag_of_sweeps(tmp_path / "bag", SWEEPS, ("/front/points", "/rear/points"))
    with pytest.raises(InvalidRequest, match="choose one of /front/points, /rear/points"):
        open_recording(bag)
    chosen = open_recording(bag, topic="/rear/points")
    assert isinstance(chosen, LidarBag)
    assert chosen.topic == "/rear/points"
    with pytest.raises(InvalidRequest, match="no topic /top of type"):
        open_recording(bag, topic="/top")


def test_scans_are_cut_from_a_bag_that_has_only_clouds(tmp_path: Path) -> None:
    recording = open_scans(bag_of_sweeps(tmp_path / "bag", SWEEPS))
    scans = list(recording)
    assert recording.scans == len(scans) == 3
    assert len(scans[0].points(50.0)) == 2, "the third point is below the band"
