from __future__ import annotations

import math

import pytest

from rce.mapping3d.evaluation.offloading import Way, measure
from tests.support.rgbd import CLEAN, simulated

RECORDING = simulated(0.4, 2.0, CLEAN)


@pytest.mark.parametrize("way", ["robot", "key frames", "jpeg"])
def test_each_way_maps_and_differs_in_who_works(way: Way) -> None:
    cost = measure(RECORDING, list(RECORDING.way), way)
    assert cost.absolute < 0.01
    assert cost.robot_load > 0
    assert (cost.line_rate > 0) == (cost.cloud_load > 0) == (way != "robot")


def test_recording_without_ground_truth_has_no_error() -> None:
    assert math.isnan(measure(RECORDING, [], "robot").absolute)
