"""Laser scans and point clouds in space, and panels side by side, in a real browser."""

from __future__ import annotations

import asyncio
import math
import re
import struct
from collections.abc import AsyncIterator
from typing import Any

import pytest

from rce.client import Robot
from tests.support.e2e.chromium import chromium, open_page, screenshot, sign_in, visit
from tests.support.e2e.real_platform import USER, RealPlatform

COUNT = """(canvas) => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    const found = [];
    for (let at = 0; at < data.length; at += 4) {
        if (data[at] === 255 && data[at + 1] === 140 && data[at + 2] === 51) found.push((at / 4) % canvas.width);
    }
    return [found.length, found.reduce((sum, each) => sum + each, 0) / found.length / canvas.width];
}"""
"""Script that returns the number of pixels in the colour of a scan, and the middle of them, from 0 to 1."""
QUARTER = {"x": 0.0, "y": 0.0, "z": 0.7071068, "w": 0.7071068}


@pytest.fixture
async def page(platform: RealPlatform) -> AsyncIterator[Any]:
    async with chromium() as browser, open_page(browser) as (page, _):
        await sign_in(page, platform.url, USER, USER)
        yield page


async def shine(robot: Robot, where: dict[str, float]) -> None:
    """Publish a scan of a wall and the cloud of a tower, and where the laser is."""
    field = robot.environment("field")
    transforms = await field.publisher("/tf", "tf2_msgs/TFMessage")
    scans = await field.publisher("/scan", "sensor_msgs/LaserScan")
    clouds = await field.publisher("/points", "sensor_msgs/PointCloud2")
    at = {"frame_id": "laser"}
    axes = [{"name": name, "offset": 4 * index, "datatype": 7, "count": 1} for index, name in enumerate("xyz")]
    around = [number / 40 for number in range(2000)]
    data = b"".join(struct.pack("<fff", math.cos(each), math.sin(each), each / 25) for each in around)
    size = {"height": 1, "width": 2000, "point_step": 12, "row_step": 24_000}
    cloud = {"header": at, **size, "fields": axes, "data": data}
    scan = {"angle_min": -1.2, "angle_max": 1.2, "angle_increment": 0.008, "range_min": 0.1, "range_max": 20.0}
    ranges = [3 + 0.4 * math.sin(number / 10) for number in range(300)]
    while True:
        pose = {"translation": {"x": where["x"], "y": where["y"], "z": 0.0}, "rotation": QUARTER}
        await transforms.publish(
            {"transforms": [{"header": {"frame_id": "map"}, "child_frame_id": "laser", "transform": pose}]}
        )
        await scans.publish({"header": at, **scan, "ranges": ranges})
        await clouds.publish({**cloud, "is_bigendian": False, "is_dense": True})
        await asyncio.sleep(0.1)


async def middle(canvas: Any) -> float:
    """Return the middle of the scan on the screen once it is drawn."""
    async with asyncio.timeout(60):
        while True:
            count, found = await canvas.evaluate(COUNT)
            if count > 20:
                return float(found)
            await asyncio.sleep(0.2)


async def test_scans_and_clouds_are_shown_where_tf_says(page: Any, platform: RealPlatform) -> None:
    async with platform.robot("shiner") as robot, robot.environment("field"):
        where = {"x": 0.0, "y": 0.0}
        shining = asyncio.create_task(shine(robot, where))
        try:
            await visit(page, f"{platform.url}ui/#/space/{USER}/field")
            await page.get_by_text(re.compile("scan: 300 points of laser in map; cloud: 2000 points")).wait_for()
            canvas = page.locator("canvas.space")
            before = await middle(canvas)
            await screenshot(page, "space")
            where.update(x=4.0, y=-2.0)
            async with asyncio.timeout(60):
                while abs(await middle(canvas) - before) < 0.05:  # noqa: ASYNC110
                    await asyncio.sleep(0.2)
            await canvas.focus()
            turned = await middle(canvas)
            await page.keyboard.press("ArrowLeft")
            await page.keyboard.press("ArrowLeft")
            async with asyncio.timeout(60):
                while abs(await middle(canvas) - turned) < 0.01:  # noqa: ASYNC110
                    await asyncio.sleep(0.2)
        finally:
            shining.cancel()


async def test_panels_are_remembered(page: Any, platform: RealPlatform) -> None:
    async with platform.robot("watcher") as robot, robot.environment("wall"):
        await page.get_by_role("link", name="wall").wait_for()
        await page.get_by_role("link", name="Panels").click()
        dialog = page.get_by_role("dialog")
        for kind in ("Map", "3D"):
            await page.get_by_role("button", name=f"Add {kind}").click()
            await dialog.get_by_label("Environment").select_option(f"{USER}/wall")
            await dialog.get_by_role("button", name="Add").click()
            await page.get_by_role("region", name=f"{kind} of wall").wait_for()
        await page.get_by_role("button", name="Move to the front 3D of wall").click()
        await page.reload()
        await page.get_by_role("region", name="3D of wall").wait_for()
        assert await page.locator(".grid h2").all_inner_texts() == ["3D of wall", "Map of wall"]
        await page.get_by_role("button", name="Remove Map of wall").click()
        await page.get_by_role("region", name="Map of wall").wait_for(state="detached")
