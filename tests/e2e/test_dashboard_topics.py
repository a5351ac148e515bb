"""The page of topics and services in a real browser: messages, plot, publishing, calling."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from rce.client import Robot
from tests.support.e2e.chromium import chromium, open_page, screenshot, sign_in, visit
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.e2e.traffic import STRING, Echo

TWIST, SET_BOOL = "geometry_msgs/Twist", "std_srvs/SetBool"
PLOTTED = """(canvas) => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let at = 0; at < data.length; at += 4) if (data[at] === 0x24 && data[at + 1] === 0x57) count += 1;
    return count;
}"""
"""Script that counts the pixels in the colour of the first line."""


@asynccontextmanager
async def signed_in(platform: RealPlatform) -> AsyncIterator[Any]:
    """Open a page whose text is in the report of a failure."""
    async with chromium() as browser, open_page(browser) as (page, _):
        await sign_in(page, platform.url, USER, USER)
        yield page


async def drive(robot: Robot) -> None:
    velocities = await robot.environment("yard").publisher("/cmd_vel", TWIST)
    for number in range(10_000):
        speed = 0.5 + 0.4 * ((number % 40) / 40)
        await velocities.publish({"linear": {"x": speed, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": -speed}})
        await asyncio.sleep(0.05)


async def test_topics_are_shown_plotted_and_published_and_services_called(platform: RealPlatform) -> None:
    async with signed_in(platform) as page, platform.robot("mower") as robot, robot.environment("yard") as yard:
        await yard.add_node("echo", "rce_demo", "echo.py")
        calls: list[Any] = []

        def switch(request: dict[str, Any]) -> dict[str, Any]:
            calls.append(request)
            return {"success": True, "message": f"light {request['data']}"}

        await yard.service_provider("/light", SET_BOOL, switch)
        heard = await yard.subscriber("/heard", STRING)
        await Echo(await yard.publisher("/say", STRING), heard).answers()
        driving = asyncio.create_task(drive(robot))
        try:
            await visit(page, f"{platform.url}ui/#/topics/{USER}/yard")
            await page.get_by_role("link", name="/cmd_vel").click()
            await page.locator("pre.message").filter(has_text='"linear"').wait_for()
            await page.get_by_label("linear.x").check()
            await wait_for_line(page.locator("canvas.plot"))
            await page.get_by_text("messages a second").wait_for()
            await page.get_by_text("Last 20 messages").click()
            await page.get_by_role("cell", name='"angular"').first.wait_for()
            await screenshot(page, "topics")

            await page.get_by_role("link", name="/say").click()
            message = page.get_by_label(f"Publish {STRING}")
            await wait_for_template(message, {"data": ""})
            await message.fill('{"data": "hello"}')
            await page.get_by_role("button", name="Publish").click()
            async with asyncio.timeout(60):
                while await heard.get() != {"data": "hello"}:
                    pass
            await message.fill('{"data": ')
            await page.get_by_role("button", name="Publish").click()
            await page.get_by_role("alert").filter(has_text="JSON").wait_for()

            await page.get_by_role("link", name="/light").click()
            request = page.get_by_label(f"Call {SET_BOOL}")
            await wait_for_template(request, {"data": False})
            await request.fill('{"data": true}')
            await page.get_by_role("button", name="Call").click()
            await page.locator("pre.message").filter(has_text="light True").wait_for()
            assert calls == [{"data": True}]
            await screenshot(page, "service")
        finally:
            driving.cancel()


async def wait_for_template(field: Any, value: Any) -> None:
    """Wait until the page has filled in a message with defaults: it may come while a test fills the field."""
    async with asyncio.timeout(60):
        while json.loads(await field.input_value() or "null") != value:  # noqa: ASYNC110
            await asyncio.sleep(0.1)


async def wait_for_line(canvas: Any) -> None:
    async with asyncio.timeout(60):
        while not await canvas.evaluate(PLOTTED) > 50:  # noqa: ASYNC110
            await asyncio.sleep(0.2)
