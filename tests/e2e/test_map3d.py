"""`rce map3d` with a real platform."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

import numpy as np

from rce.mapping3d.evaluation.building import spinning
from rce.mapping3d.evaluation.errors import absolute_error
from rce.mapping3d.evaluation.room import SimulatedRecording, sweep
from rce.mapping3d.files.trajectories import read_trajectory
from tests.support.e2e.chromium import chromium, open_page, sign_in
from tests.support.e2e.mapping import rce_map
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.rgbd import CLEAN, simulated, write_bag1, write_seven_scenes
from tests.support.sweeps import bag_of_sweeps, drive

GREY = """(canvas) => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    const grey = (at) => data[at] === 190 && data[at + 1] === 190 && data[at + 2] === 190;
    return data.filter((_, at) => at % 4 === 0 && grey(at)).length > 500;
}"""
"""Script that returns whether there are many pixels in the colour of points without colour."""
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


async def test_lidar_is_mapped_and_its_cloud_is_shown_in_the_dashboard(platform: RealPlatform, tmp_path: Path) -> None:
    bag = bag_of_sweeps(tmp_path / "bag", drive(1.5, spinning(16, 180), begin=5.0))
    words = ("--url", platform.url, "--out", tmp_path / "map")
    done = await rce_map(bag, *words, temporary=tmp_path, command="map3d")
    assert done.status == 0, done.errors
    assert "15 frames, 0 without track" in done.output
    assert {path.name for path in (tmp_path / "map").iterdir()} == FILES | {"trajectory.txt"}
    submit = ("submit", next(bag.glob("*.mcap")), "--kind", "3d", "--wait", "--url", platform.url, "--user", USER)
    done = await rce_map(*submit, "--password", USER, "--out", tmp_path / "job", temporary=tmp_path)
    assert done.status == 0, done.errors
    async with chromium() as browser, open_page(browser) as (page, _):
        await sign_in(page, platform.url, USER, USER)
        await page.get_by_role("link", name="Recordings").click()
        await page.get_by_role("button", name="Show cloud").first.click()  # of the newest job
        dialog = page.get_by_role("dialog", name="Cloud")
        await dialog.get_by_text(re.compile(r"^\d{4,} points\. Drag to turn")).wait_for()
        canvas = dialog.locator("canvas.space")
        async with asyncio.timeout(60):
            while True:  # the page's Content-Security-Policy forbids wait_for_function
                if await canvas.evaluate(GREY):
                    break
                await asyncio.sleep(0.2)
