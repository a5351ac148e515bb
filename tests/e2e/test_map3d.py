"""`rce map3d` with a real platform."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.evaluation.room import SimulatedRecording, sweep
from rce.mapping3d.files.trajectories import read_trajectory
from tests.support.e2e.mapping import rce_map
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.rgbd import CLEAN, simulated, write_bag1, write_seven_scenes

FILES = {"cloud.ply", "map.bt", "map.pgm", "map.yaml", "mesh.ply", "view.png"}


async def test_two_robots_in_a_room_get_one_map(platform: RealPlatform, tmp_path: Path) -> None:
    ways = [sweep(0.5, 2.0), sweep(0.5, 2.0, begin=0.5)]
    names = [
        write_seven_scenes(tmp_path / f"robot{number}", list(SimulatedRecording("room", way, CLEAN)))
        for number, way in enumerate(ways)
    ]
    words = ("--url", platform.url, "--out", tmp_path / "map")
    done = await rce_map(*names, *words, temporary=tmp_path, command="map3d")
    assert done.status == 0, done.errors
    assert "30 frames, 0 without track" in done.output
    written = {path.name for path in (tmp_path / "map").iterdir()}
    assert written == FILES | {"trajectory-1.txt", "trajectory-2.txt"}, done.output
    paths = [read_trajectory(tmp_path / "map" / f"trajectory-{number}.txt") for number in (1, 2)]
    np.testing.assert_allclose(paths[0][0][1], np.eye(4), atol=1e-6)
    estimate = [pose for path in paths for _, pose in path]
    assert absolute_error(estimate, [pose for way in ways for _, pose in way]) < 0.02


async def test_map_service_maps_the_bag_of_a_camera(platform: RealPlatform, tmp_path: Path) -> None:
    bag = write_bag1(tmp_path, list(simulated(0.3, 2.0, CLEAN)))
    words = ("submit", bag, "--kind", "3d", "--wait", "--url", platform.url, "--user", USER, "--password", USER)
    done = await rce_map(*words, "--out", tmp_path / "map", temporary=tmp_path)
    assert done.status == 0, done.errors
    written = {path.name for path in (tmp_path / "map").iterdir()}
    assert written == FILES | {"trajectory.txt", "log.txt", "times.json"}
    assert len(read_trajectory(tmp_path / "map" / "trajectory.txt")) == 9
