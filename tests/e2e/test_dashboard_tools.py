"""Tools of the dashboard that the console has too: parameters, terminal, packages, events, output and traces."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from rce.client import Robot
from tests.support.e2e.chromium import chromium, open_page, sign_in, visit
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.e2e.traffic import STRING, call
from tests.support.recordings import carmen, flaser

DROPPED = """(files) => {
    const dropped = new DataTransfer();
    for (const [name, text] of files) dropped.items.add(new File([text], name));
    return dropped;
}"""
"""Script that returns what a browser passes when files are dropped."""
TALKER = "#!/usr/bin/env python3\nprint('here I am')\n"


@pytest.fixture(scope="module")
async def browser() -> AsyncIterator[Any]:
    async with chromium() as browser:
        yield browser


@pytest.fixture
async def page(browser: Any, platform: RealPlatform) -> AsyncIterator[Any]:
    async with open_page(browser) as (page, _):
        await sign_in(page, platform.url, USER, USER)
        yield page


async def test_parameters_are_edited_within_their_ranges(page: Any, platform: RealPlatform) -> None:
    async with platform.robot("tuner") as robot, robot.environment("tuned") as tuned:
        await tuned.add_node("mapper", "rce_mapping", "mapper")
        names = await tuned.service_client("/mapper/list_parameters", "rcl_interfaces/ListParameters")
        await call(names, {"prefixes": [], "depth": 0}, 120)  # the node may still be starting
        await visit(page, f"{platform.url}ui/#/environments/{USER}/tuned")
        await page.get_by_role("link", name="Of running nodes").click()
        field = page.get_by_label("map_update_interval", exact=True)
        await field.wait_for()
        assert await field.get_attribute("max") == "3600"
        assert await page.get_by_label("mapper", exact=True).is_disabled(), "it is read only"
        await field.fill("99999")
        await field.press("Tab")
        await page.get_by_role("alert").filter(has_text="3600").wait_for()
        await field.fill("7.5")
        await field.press("Tab")
        await page.get_by_role("alert").filter(has_text="3600").wait_for(state="detached")
        await page.get_by_role("status").filter(has_text=re.compile("^set$")).wait_for()
        await page.reload()
        await field.wait_for()
        assert await field.input_value() == "7.5"


async def test_terminal_runs_commands(page: Any, platform: RealPlatform) -> None:
    async with platform.robot("typist") as robot, robot.environment("office"):
        await visit(page, f"{platform.url}ui/#/environments/{USER}/office")
        await page.get_by_role("link", name="Terminal").click()
        await page.get_by_role("status").filter(has_text="connected").wait_for()
        await page.locator("#terminal :focus").wait_for(state="attached")
        await page.keyboard.type("echo $((6 * 7))! && exit 3\n")
        await page.locator(".xterm-rows").filter(has_text=re.compile("42!")).wait_for()
        await page.get_by_role("status").filter(has_text="ended with status 3").wait_for()
        await page.get_by_role("link", name="To the dashboard").click()
        await page.get_by_role("heading", name="office").wait_for()


async def test_package_is_pushed_shared_and_removed(page: Any, platform: RealPlatform, tmp_path: Path) -> None:
    package = tmp_path / "dropped"
    (package / "scripts").mkdir(parents=True)
    (package / "package.xml").write_text("<package format='3'><name>dropped_talker</name></package>")
    (package / "scripts" / "talk").write_text(TALKER)
    await page.get_by_role("link", name="Packages").click()
    await page.locator("input[type=file]").set_input_files(package)
    await page.get_by_role("heading", name=f"{USER}/dropped_talker").wait_for()
    await page.get_by_role("button", name=f"Share {USER}/dropped_talker").click()
    dialog = page.get_by_role("dialog")
    await dialog.get_by_label("With").fill("*")
    await dialog.get_by_role("button", name="Share").click()
    await page.get_by_text("shared with everybody").wait_for()
    async with platform.robot("visitor") as robot, robot.environment("stage", packages=["dropped_talker"]) as stage:
        events = robot.events()
        await stage.add_node("talk", "dropped_talker", "talk")
        await asyncio.wait_for(node_ends(events), 60)
    await page.get_by_role("button", name="Stop sharing").click()
    await page.get_by_text("not shared", exact=True).wait_for()
    await page.get_by_role("button", name=re.compile("^Remove version")).click()
    await dialog.get_by_role("button", name="Remove").click()
    await page.get_by_role("heading", name=f"{USER}/dropped_talker").wait_for(state="detached")


async def node_ends(events: Any) -> None:
    async for event in events:
        if getattr(event, "nodeTag", "") == "talk":
            return


async def test_events_and_output_are_filtered(page: Any, platform: RealPlatform) -> None:
    async with platform.robot("eventful") as robot, robot.environment("scene") as scene:
        await scene.add_node("echo", "rce_demo", "echo.py")
        await visit(page, f"{platform.url}ui/#/events?type=robot&text=eventful")
        await page.get_by_role("cell", name="robot.came").first.wait_for()
        assert await page.get_by_role("cell", name="environment.ready").count() == 0
        await page.get_by_label("Type").select_option("environment.ready")
        await page.get_by_label("Text").fill("scene")
        await page.get_by_role("cell", name=f"{USER}/scene").first.wait_for()
        await page.reload()
        await page.get_by_role("cell", name=f"{USER}/scene").first.wait_for()
        await visit(page, f"{platform.url}ui/#/environments/{USER}/scene?lines=nothing+has+this")
        await page.get_by_role("cell", name="rce_demo echo.py").wait_for()
        assert await page.get_by_label("Lines with").input_value() == "nothing has this"


async def test_trace_shows_the_hops_of_messages(page: Any, platform: RealPlatform) -> None:
    async with platform.robot("tracer") as robot, robot.environment("lab") as lab:
        publisher = await lab.publisher("/say", STRING)
        talking = asyncio.create_task(talk(robot, publisher))
        try:
            await visit(page, f"{platform.url}ui/#/trace/{USER}/tracer/lab_pub_say")
            await page.get_by_text("to lab/pub_say").first.wait_for()
            await page.get_by_text(re.compile(r"sent \d+ µs")).first.wait_for()
            await page.get_by_text(
                re.compile(r"Median of the last \d\d")
            ).wait_for()  # bars have changed, within the page's policy
            await page.get_by_role("button", name="Pause").click()
        finally:
            talking.cancel()


async def talk(robot: Robot, publisher: Any) -> None:
    while True:
        await publisher.publish({"data": robot.name})
        await asyncio.sleep(0.1)


async def test_recording_is_uploaded_and_its_map_shown(page: Any, platform: RealPlatform, tmp_path: Path) -> None:
    recording = carmen(tmp_path / "lobby.log", "".join(flaser(1 + number / 10, number / 100) for number in range(60)))
    await page.get_by_role("link", name="Recordings").click()
    await page.get_by_role("button", name="Choose recordings").wait_for()
    dropped = await page.evaluate_handle(DROPPED, [[recording.name, recording.read_text()]])
    await page.locator(".drop").dispatch_event("drop", {"dataTransfer": dropped})
    row = page.get_by_role("row").filter(has_text="map.png")
    await row.wait_for(timeout=300_000)
    await row.get_by_role("button", name="Show map").click()
    dialog = page.get_by_role("dialog")
    await dialog.get_by_role("img", name="Map").wait_for()
    await dialog.get_by_role("button", name="Close").click()
    async with page.expect_download() as started:
        await row.get_by_role("button", name="map.yaml").click()
    download = await started.value
    await download.save_as(tmp_path / "map.yaml")
    assert "resolution: 0.05" in (tmp_path / "map.yaml").read_text()
    await row.get_by_role("button", name="Remove").click()
    await dialog.get_by_role("button", name="Remove").click()
    await row.wait_for(state="detached")
    await page.get_by_text("Options").click()
    await page.get_by_label("Workers").fill("2")
    files = [[name, recording.read_text()] for name in ("monday.log", "tuesday.log")]
    dropped = await page.evaluate_handle(DROPPED, files)
    await page.locator(".drop").dispatch_event("drop", {"dataTransfer": dropped})
    row = page.get_by_role("row").filter(has_text="2 recordings")
    await row.get_by_role("button", name="trajectory_2.txt").wait_for(timeout=300_000)
    assert "failed" not in await row.inner_text()


async def test_goal_of_an_action_gets_feedback_and_result_and_is_canceled(page: Any, platform: RealPlatform) -> None:
    pytest.importorskip("test_msgs", reason="needs ros-test-msgs")
    async with platform.robot("counter") as robot, robot.environment("numbers") as numbers:
        await numbers.add_node("server", "Relay", "fibonacci.py")
        await visit(page, f"{platform.url}ui/#/topics/{USER}/numbers")
        await page.get_by_role("link", name="/fibonacci", exact=True).click()
        goal = page.get_by_label("Send goal test_msgs/Fibonacci")
        await goal.fill('{"order": 8}')
        succeeded = page.get_by_role("status").filter(has_text="succeeded")
        unanswered = page.get_by_role("alert").filter(has_text="did not")
        while not await succeeded.is_visible():  # the answer is lost if DDS discovery has not finished
            await page.get_by_role("button", name="Send goal").click()
            await succeeded.or_(unanswered).first.wait_for()
        assert "13" in await page.locator("pre.message").last.inner_text()
        await goal.fill('{"order": 0}')
        await page.get_by_role("button", name="Send goal").click()
        await page.get_by_role("button", name="Cancel goal").click()
        await page.get_by_role("status").filter(has_text="canceled").wait_for()
