from __future__ import annotations

import numpy as np

from rce.mapping3d.evaluation.room import QVGA, Faults, SimulatedRecording, look, render, sweep
from tests.support.rgbd import CLEAN


def test_wall_is_as_far_as_it_is() -> None:
    _, depth = render(look((3.0, 4.0, 2.3), (6.0, 4.0, 2.3)), QVGA)
    assert depth[100, 160] == np.float32(3.0)


def test_furniture_hides_the_wall() -> None:
    _, depth = render(look((5.0, 3.0, 1.0), (5.0, 0.0, 1.0)), QVGA)
    np.testing.assert_allclose(depth[120, 160], 2.6, atol=1e-5)


def test_point_looks_the_same_from_two_sides() -> None:
    first, second = look((3.0, 3.0, 1.2), (1.5, 1.0, 0.75)), look((2.6, 3.1, 1.3), (1.5, 1.0, 0.75))
    colors = [render(pose, QVGA)[0][120, 160].astype(int) for pose in (first, second)]
    assert np.abs(colors[0] - colors[1]).max() < 12


def test_noise_of_the_depth_grows_with_the_distance() -> None:
    recording = SimulatedRecording("room", sweep(0.1))
    frame = next(iter(recording))
    _, true = render(recording.way[0][1], QVGA)
    error = np.abs(frame.depth - true)
    known = frame.depth > 0
    near, far = (error[known & (true < 2.5)], error[known & (true > 3.0)])
    assert 0.001 < near.mean() < far.mean() < 0.05


def test_faults_of_a_camera_are_as_asked_for() -> None:
    way = sweep(0.6, 5.0)
    clean, faulty = (
        list(SimulatedRecording("room", way, faults))[8]
        for faults in (CLEAN, Faults(blur=0.8, exposure=0.3, missing=0.4))
    )
    assert (faulty.depth == 0).mean() > 0.35
    assert (clean.depth == 0).mean() < 0.2
    assert faulty.color.mean() > 1.1 * clean.color.mean()
    edges = [np.abs(np.diff(frame.color.astype(float), axis=1)).mean() for frame in (clean, faulty)]
    assert edges[1] < edges[0]
