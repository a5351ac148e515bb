"""The dashboard in a real browser with a real platform. No page may log an error."""

from __future__ import annotations

import asyncio
import itertools
import re
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Any

import pytest

from rce.client import Event, Robot, Stream
from rce.errors import Unauthorized
from rce.mapping.evaluation.simulation import simulate
from rce.mapping.robot import MappingRobot
from rce.mapping.scans import Scan
from rce.protocol.messages import AddInterface
from tests.support.e2e.chromium import NARROW, chromium, open_page, screenshot, sign_in, visit
from tests.support.e2e.real_platform import USER, RealPlatform, until
from tests.support.e2e.traffic import STRING, Echo

IMAGE, TWIST = "sensor_msgs/Image", "geometry_msgs/Twist"
TRAIL = """(canvas) => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let at = 0; at < data.length; at += 4) if (data[at] === 0xd9 && data[at + 1] === 0x48) count += 1;
    return count;
}"""
"""Script that counts the pixels in the colour of the robot's trail."""


@pytest.fixture(scope="module")
async def browser() -> AsyncIterator[Any]:
    async with chromium() as browser:
        yield browser


@asynccontextmanager
async def signed_in(browser: Any, platform: RealPlatform, user: str = USER, **options: Any) -> AsyncIterator[Any]:
    async with open_page(browser, **options) as (page, _):
        await sign_in(page, platform.url, user, user)
        yield page


def port(page: Any, owner: str, tag: str) -> Any:
    return page.get_by_role("button", name=f"{owner}/{tag},")


async def test_wrong_password_and_revoked_session(browser: Any, platform: RealPlatform) -> None:
    async with open_page(browser) as (page, errors):
        await visit(page, platform.url)  # the robots' entry redirects browsers
        await page.wait_for_url("**/ui/")
        await screenshot(page, "signin")
        await page.get_by_label("User").fill(USER)
        await page.get_by_label("Password").fill("wrong")
        await page.get_by_role("button", name="Sign in").click()
        await page.get_by_role("alert").filter(has_text=re.compile("wrong", re.I)).wait_for()
        assert "401" in errors.pop()
        await sign_in(page, platform.url, USER, USER)
        key = await page.evaluate("sessionStorage.getItem('rce.key')")
        await page.reload()
        await page.get_by_role("heading", name="Robots and environments").wait_for()
        await page.get_by_role("button", name="Sign out").click()
        await page.get_by_role("heading", name="Sign in").wait_for()
        await page.evaluate("(key) => sessionStorage.setItem('rce.key', key)", key)
        await page.reload()
        await page.get_by_role("alert").filter(has_text="revoked").wait_for()
        assert "401" in errors.pop()


async def test_page_recovers_from_a_file_that_did_not_arrive(browser: Any, platform: RealPlatform) -> None:
    async with open_page(browser) as (page, errors):
        failures = iter(["connectionreset"])

        async def answer(route: Any) -> None:
            failure = next(failures, None)
            await (route.abort(failure) if failure else route.continue_())

        await page.route("**/ui/keys.js", answer)
        await sign_in(page, platform.url, USER, USER)
        assert "ERR_CONNECTION_RESET" in errors.pop()


async def test_page_that_cannot_be_loaded_shows_an_error(browser: Any, platform: RealPlatform) -> None:
    async with open_page(browser) as (page, errors):
        await page.route("**/ui/keys.js", lambda route: route.abort("connectionreset"))
        await visit(page, f"{platform.url}ui/")
        await page.get_by_text("The Master cannot be reached").wait_for()
        errors.clear()


async def test_request_without_an_answer_is_sent_again(browser: Any, platform: RealPlatform) -> None:
    async with open_page(browser) as (page, errors):
        failures = iter(["connectionreset", "connectionreset"])

        async def answer(route: Any) -> None:
            failure = next(failures, None)
            await (route.abort(failure) if failure else route.continue_())

        await page.route("**/api/v1/keys", answer)
        await sign_in(page, platform.url, USER, USER)
        assert len(errors) == 2
        errors.clear()


async def test_first_steps_are_shown_until_something_runs(browser: Any, fragile: RealPlatform) -> None:
    async with signed_in(browser, fragile) as page:
        await page.get_by_role("heading", name="Nothing runs here yet").wait_for()
        await screenshot(page, "first-steps")
        for step, line in (
            ("Try a simulated robot", f"rce map --simulate --url {fragile.url} --user {USER}"),
            ("Upload a recording", f"rce map submit corridor.bag --wait --out corridor --url {fragile.url}"),
            ("Connect a robot", f'Robot("{fragile.url}", user="{USER}", robot="r2d2"'),
        ):
            await page.get_by_role("button", name=step).click()
            await page.get_by_role("dialog", name=step).get_by_text(line).wait_for()
            await page.get_by_role("button", name="Close").click()
        async with fragile.robot("first"):
            await page.get_by_text("1 robot, 0 environments").wait_for()
            await page.get_by_role("heading", name="Nothing runs here yet").wait_for(state="hidden")


async def wait_for_trail(canvas: Any, most: float) -> int:
    """Wait until the trail has more than `most` pixels, and return their number."""
    async with asyncio.timeout(60):
        while True:  # the page's Content-Security-Policy forbids wait_for_function
            count: int = await canvas.evaluate(TRAIL)
            if count > most:
                return count
            await asyncio.sleep(0.2)


@asynccontextmanager
async def prepared(mapping: MappingRobot) -> AsyncIterator[None]:
    await mapping.prepare({"map_update_interval": 0.5})
    yield


def laps() -> Iterator[Scan]:
    """Yield scans for as long as the pages need."""
    records = simulate().records
    for lap in itertools.count():
        for scan in records:
            yield replace(scan, stamp=scan.stamp + 1000 * lap)


async def test_live_map_and_graph_of_a_mapping_robot(browser: Any, platform: RealPlatform) -> None:
    async with (
        platform.robot("surveyor") as robot,
        robot.environment("building") as building,
        MappingRobot(robot, building) as mapping,
        prepared(mapping),
        signed_in(browser, platform) as page,
    ):
        await visit(page, f"{platform.url}ui/#/map")
        assert await page.locator("div.head").first.inner_text() == "Map", "nothing is chosen yet"
        await visit(page, f"{platform.url}ui/#/map/{USER}/building")
        canvas = page.locator("canvas.map")
        driving = asyncio.create_task(mapping.drive(laps(), lambda _: None))
        await page.get_by_role("status").filter(has_text="cells of").wait_for()
        early = await wait_for_trail(canvas, 10)
        await wait_for_trail(canvas, 1.3 * early)
        await visit(page, f"{platform.url}ui/#/")
        connections = page.get_by_role("button", name=re.compile("connection surveyor.*scan"))
        await connections.filter(has_text=re.compile(r"\d/s")).first.wait_for()
        await screenshot(page, "graph")
        await page.get_by_role("link", name="building", exact=True).click()
        await page.get_by_role("heading", name="building").wait_for()
        await page.get_by_role("cell", name="rce_mapping mapper").wait_for()
        await page.locator(".figure").filter(has_text="MiB").wait_for()
        assert not driving.done()
        driving.cancel()
        await screenshot(page, "environment")
        await visit(page, f"{platform.url}ui/#/map/{USER}/building")
        await wait_for_trail(canvas, 10)
        await screenshot(page, "map")
        await check_administrator_as_guest(browser, platform)
        await visit(page, f"{platform.url}ui/#/environments/{USER}/building")
        platform.kill(platform.pid("rce_mapping/mapper"))
        await page.locator("#notices").get_by_text("Node building/mapper ended").wait_for()
        await screenshot(page, "node-died")


async def check_administrator_as_guest(browser: Any, platform: RealPlatform) -> None:
    """Check that an administrator sees the user's map, and that the user sees the guest."""
    async with signed_in(browser, platform, user="admin") as page:
        await page.get_by_text("You have no robots or environments now.").wait_for()
        await page.get_by_label("all users").check()
        await page.get_by_role("link", name="Map").click()
        await page.get_by_label("Environment").select_option(f"{USER}/building")
        await page.get_by_role("button", name="Show").click()
        await wait_for_trail(page.locator("canvas.map"), 10)
        await page.reload()  # the URL names the user
        await wait_for_trail(page.locator("canvas.map"), 10)
        await page.get_by_role("link", name="Graph").click()
        await page.get_by_label("all users").check()
        await page.get_by_text(re.compile(rf"{USER}/@browser_\w+ \({USER}\)")).first.wait_for()
        await visit(page, f"{platform.url}ui/#/environments/{USER}/building")
        await page.get_by_role("cell", name="rce_mapping mapper").wait_for()


async def test_connect_and_disconnect_by_mouse_and_keyboard(browser: Any, platform: RealPlatform) -> None:
    async with (
        platform.robot("left") as left,
        platform.robot("right") as right,
        right.environment("middle"),
        signed_in(browser, platform) as page,
    ):
        said = await left.publisher("said", STRING)
        heard = await right.subscriber("heard", STRING)
        await right.configure(
            AddInterface("middle", "words", "PublisherInterface", STRING, "/say"),
            AddInterface("middle", "echo", "SubscriberInterface", STRING, "/heard"),
        )
        await right.add_node("middle", "echo", "rce_demo", "echo.py")
        await port(page, "left", "said").click()
        await page.get_by_text("Choose what to connect said with").wait_for()
        assert "fits" in (await port(page, "middle", "words").get_attribute("class") or "")
        assert "fits" not in (await port(page, "middle", "echo").get_attribute("class") or "")
        await port(page, "middle", "words").click()
        await port(page, "right", "heard").focus()
        await page.keyboard.press("Enter")
        await port(page, "middle", "echo").focus()
        await page.keyboard.press("Enter")
        await page.get_by_role("button", name="connection middle/echo to right/heard").wait_for()
        await Echo(said, heard).answers()
        await screenshot(page, "connected")
        await page.get_by_role("button", name="connection left/said to middle/words").focus()
        await page.keyboard.press("Enter")
        await page.get_by_role("dialog").get_by_role("button", name="Disconnect").click()
        await page.get_by_text("Disconnected left/said and middle/words").wait_for()
        await until(lambda: not said.connected)


async def test_create_and_remove_by_mouse(browser: Any, platform: RealPlatform) -> None:
    async with open_page(browser, viewport=NARROW, color_scheme="dark") as (page, _):
        await sign_in(page, platform.url, USER, USER)
        await page.get_by_role("button", name="New environment").click()
        await page.get_by_label("Name", exact=True).fill("1bad")
        await page.get_by_label("Name", exact=True).fill("clicked")
        await screenshot(page, "new-environment-dark")
        await page.get_by_role("dialog").get_by_role("button", name="Create").click()
        await page.get_by_role("link", name="clicked").click()
        await page.get_by_role("button", name="Start node").click()
        dialog = page.get_by_role("dialog")
        await dialog.get_by_label("Name", exact=True).fill("echo")
        await dialog.get_by_label("ROS package").fill("rce_demo")
        await dialog.get_by_label("Executable").fill("nothing.py")
        await dialog.get_by_role("button", name="Create").click()
        await dialog.get_by_role("alert").filter(has_text="nothing.py").wait_for()  # the error of the server
        await dialog.get_by_label("Executable").fill("echo.py")
        await dialog.get_by_role("button", name="Create").click()
        await page.get_by_role("cell", name="rce_demo echo.py").wait_for()
        await page.get_by_role("button", name="Set parameter").click()
        await dialog.get_by_label("Name").fill("rate")
        await dialog.get_by_label("Value").fill("12.5")
        await dialog.get_by_role("button", name="Set").click()
        await page.get_by_role("cell", name="12.5").wait_for()
        await page.get_by_role("button", name="Add interface").click()
        await dialog.get_by_label("Name").fill("heard")
        await dialog.get_by_label("Kind").select_option("SubscriberInterface")
        await dialog.get_by_label("ROS type").fill(STRING)
        await dialog.get_by_label("Topic, service or action").fill("/heard")
        await dialog.get_by_role("button", name="Create").click()
        await page.get_by_role("cell", name="/heard").wait_for()
        await dialog.wait_for(state="detached")
        await screenshot(page, "environment-dark")
        await page.get_by_role("button", name="Stop echo").click()
        await page.get_by_text("No nodes run here").wait_for()
        await page.get_by_role("button", name="Stop environment").click()
        await dialog.get_by_role("button", name="Stop environment").click()
        await page.get_by_role("heading", name="Robots and environments").wait_for()
        await page.get_by_role("link", name="clicked").wait_for(state="detached")


async def test_live_image_and_joystick(browser: Any, platform: RealPlatform) -> None:
    picture = {"height": 48, "width": 64, "encoding": "rgb8", "step": 192, "data": bytes(range(192)) * 48}
    async with platform.robot("rover") as rover, rover.environment("cockpit") as cockpit:
        await cockpit.add_node("relay", "Relay", "relay.py", args=f"{IMAGE} {TWIST}")
        camera = await cockpit.publisher("/in_Image", IMAGE, format="json")
        velocity = await cockpit.subscriber("/out_Twist", TWIST, depth=1)

        async def film() -> None:
            while True:
                camera.offer(picture)
                await asyncio.sleep(0.1)

        filming = asyncio.create_task(film())
        try:
            async with signed_in(browser, platform) as page:
                await visit(page, f"{platform.url}ui/#/image/{USER}/cockpit?topic=/out_Image")
                await page.get_by_text(re.compile("64 . 48, ")).wait_for()
                await screenshot(page, "image")
                await visit(page, f"{platform.url}ui/examples/joystick.html")
                assert await page.get_by_role("link", name="To the dashboard").get_attribute("href") == "../#/"
                await page.get_by_label("Environment").fill("cockpit")
                await page.get_by_label("Velocity").fill("/in_Twist")
                await page.get_by_label("Camera").fill("/out_Image")
                await page.get_by_role("button", name="Connect").click()
                await page.get_by_text(re.compile("64 . 48, ")).wait_for()
                await page.locator("#stick").focus()
                await page.keyboard.down("ArrowUp")
                assert (await velocity.get(60))["linear"]["x"] == 0.5
                await screenshot(page, "joystick")
                await page.keyboard.up("ArrowUp")
                async with asyncio.timeout(60):
                    while (await velocity.get())["linear"]["x"]:
                        pass
        finally:
            filming.cancel()


async def test_pages_of_administrators(browser: Any, platform: RealPlatform) -> None:
    async with signed_in(browser, platform, user="admin") as page:
        await page.get_by_role("link", name="Machines").click()
        await page.get_by_text(re.compile(r"\d+ of \d+ slots")).wait_for()
        await screenshot(page, "machines")
        await page.get_by_role("link", name="Users").click()
        await page.get_by_role("link", name=USER).wait_for()
        await screenshot(page, "users")
        await page.get_by_role("link", name=USER).click()
        await page.get_by_role("cell", name="Stored packages").wait_for()
        await page.get_by_role("button", name="New key").click()
        dialog = page.get_by_role("dialog")
        await dialog.get_by_label("Label").fill("vacuum cleaner")
        await dialog.get_by_label("Only robotID").fill("vacuum")
        await dialog.get_by_label("Your password").fill("admin")
        await dialog.get_by_role("button", name="Create").click()
        key = await dialog.locator(".secret").inner_text()
        await dialog.get_by_role("button", name="Close").click()
        await page.get_by_role("cell", name="robot vacuum").wait_for()
        await screenshot(page, "user")
        async with Robot(platform.url, user=USER, robot="vacuum", key=key) as vacuum:
            events = vacuum.events()
            row = page.get_by_role("row").filter(has_text="vacuum cleaner")
            await row.get_by_role("button", name="Revoke").click()
            await dialog.get_by_role("button", name="Revoke").click()
            await row.wait_for(state="detached")
            with pytest.raises(Unauthorized, match="revoked"):
                await asyncio.wait_for(read_until_end(events), 60)


async def read_until_end(events: Stream[Event]) -> None:
    async for _ in events:
        pass


async def test_own_keys(browser: Any, platform: RealPlatform) -> None:
    async with signed_in(browser, platform) as page:
        await page.get_by_role("link", name="Keys").click()
        await page.get_by_role("cell", name="dashboard").first.wait_for()
        assert await page.get_by_role("link", name="Users").count() == 0
        await screenshot(page, "keys")
        await page.get_by_role("link", name="Audit").click()
        await page.get_by_role("cell", name="key.create").first.wait_for()
        await screenshot(page, "audit")
