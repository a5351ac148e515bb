"""Layout and state of the dashboard's pages: widths, labels, filters in the address, forms with present values."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from typing import Any

import cv2
import pytest

from rce.protocol.messages import AddInterface
from tests.support.e2e.chromium import NARROW, PHONE, WIDE, chromium, open_page, sign_in, visit
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.e2e.squeezed import squeezed
from tests.support.pictures import color

STRING = "std_msgs/String"


@pytest.fixture(scope="module")
async def browser() -> AsyncIterator[Any]:
    async with chromium() as browser:
        yield browser


async def test_narrow_pages_break_no_words_and_hide_no_buttons(browser: Any, platform: RealPlatform) -> None:
    async with platform.robot("slim") as robot, robot.environment("wardrobe") as wardrobe:
        await wardrobe.add_node("echo", "rce_demo", "echo.py")
        await wardrobe.set_parameter("map_update_interval", 0.5)
        for tag, kind in (("heard", "SubscriberInterface"), ("said_by_the_robot", "PublisherInterface")):
            await robot.configure(AddInterface("wardrobe", tag, kind, STRING, f"/{tag}"))
        for width in (WIDE, NARROW, PHONE):
            async with open_page(browser, viewport=width) as (page, _):
                await sign_in(page, platform.url, USER, USER)
                assert await squeezed(page) == []
                await visit(page, f"{platform.url}ui/#/environments/{USER}/wardrobe")
                await page.get_by_role("cell", name="/said_by_the_robot").wait_for()
                await page.get_by_role("cell", name="rce_demo echo.py").wait_for()
                await page.locator(".figure").filter(has_text="MiB").wait_for()
                assert await squeezed(page) == []


async def test_filter_is_in_the_address_and_keeps_the_peers(browser: Any, platform: RealPlatform) -> None:
    async with (
        platform.robot("talker") as robot,
        robot.environment("studio") as studio,
        robot.environment("attic"),
        open_page(browser) as (page, _),
    ):
        await studio.publisher("/say", STRING)
        await sign_in(page, platform.url, USER, USER)
        await page.get_by_role("link", name="attic").wait_for()
        await page.get_by_label("Filter").fill("talker")
        await page.get_by_role("link", name="attic").wait_for(state="detached")
        await page.reload()
        await page.get_by_role("region", name="environment studio").wait_for()
        assert await page.get_by_label("Filter").input_value() == "talker"
        assert await page.get_by_role("link", name="attic").count() == 0
        await page.get_by_role("button", name="talker/studio_pub_say, Subscriber of std_msgs/String, sends").wait_for()
        await page.get_by_role("button", name="studio/pub_say, Publisher of std_msgs/String, receives").wait_for()
        await visit(page, f"{platform.url}ui/#/audit?action=environment.create")
        await page.get_by_role("cell", name="environment.create").first.wait_for()
        assert await page.get_by_role("cell", name="login").count() == 0


async def test_pages_of_an_environment_say_that_it_has_ended(browser: Any, platform: RealPlatform) -> None:
    async with platform.robot("brief") as robot, open_page(browser) as (page, errors):
        async with robot.environment("hall"):
            await sign_in(page, platform.url, USER, USER)
            await visit(page, f"{platform.url}ui/#/map/{USER}/hall")
            await page.get_by_label("Environment").locator(f"option[value='{USER}/hall']").wait_for(state="attached")
        await page.get_by_text("The environment hall has ended").wait_for()
        # The page may have asked for its topics while it was away already, and not yet removed.
        errors[:] = [each for each in errors if not ("503" in each and "/environments/hall/topics" in each)]


async def test_quota_form_has_the_present_values(browser: Any, platform: RealPlatform) -> None:
    async with open_page(browser) as (page, _):
        await sign_in(page, platform.url, "admin", "admin")
        await visit(page, f"{platform.url}ui/#/users/{USER}")
        dialog = page.get_by_role("dialog")
        for before, after in (("-", "3Gi"), ("3Gi", "-")):
            await page.get_by_role("button", name="Change quotas").click()
            field = dialog.get_by_role("textbox", name="disk", exact=False).first
            assert await field.input_value() == before
            await field.fill(after)
            await dialog.get_by_role("button", name="Change").click()
            await dialog.wait_for(state="detached")
        await visit(page, f"{platform.url}ui/#/users")
        await page.get_by_text(re.compile("Environments: ")).first.wait_for()


async def test_new_environment_has_variables_and_suggestions(browser: Any, platform: RealPlatform) -> None:
    async with platform.robot("suggester") as robot, open_page(browser) as (page, _):
        async with robot.environment("model", group="team"):
            await sign_in(page, platform.url, USER, USER)
            await page.get_by_role("link", name="model").wait_for()
            await page.get_by_role("button", name="New environment").click()
            dialog = page.get_by_role("dialog")
            await dialog.locator("#group-list option[value=team]").wait_for(state="attached")
            for label in ("Image", "Packages", "GPUs"):
                await dialog.get_by_label(label).wait_for()
            await dialog.get_by_label("Name", exact=True).fill("filled")
            await dialog.get_by_label("Variables").fill("nonsense")
            await dialog.get_by_role("button", name="Create").click()
            await dialog.get_by_role("alert").filter(has_text="NAME=VALUE").wait_for()
            await dialog.get_by_label("Variables").fill("COLOUR=blue")
            await dialog.get_by_role("button", name="Create").click()
            await page.get_by_role("link", name="filled").click()
            await page.get_by_text("COLOUR=blue").wait_for()
        await robot.environment("filled").destroy()


async def test_page_without_a_choice_shows_a_topic_that_the_environment_has(
    browser: Any, platform: RealPlatform
) -> None:
    picture = cv2.imencode(".png", color(0, 32, 24))[1].tobytes()
    async with platform.robot("photographer") as robot, robot.environment("studio2") as studio:
        camera = await studio.publisher("/lens/compressed", "sensor_msgs/CompressedImage")

        async def film() -> None:
            while True:
                await camera.publish({"format": "png", "data": picture})
                await asyncio.sleep(0.1)

        filming = asyncio.create_task(film())
        async with open_page(browser) as (page, _):
            await sign_in(page, platform.url, USER, USER)
            await visit(page, f"{platform.url}ui/#/image/{USER}/studio2")
            await page.get_by_text(re.compile("^32 . 24, ")).wait_for()
            assert await page.get_by_label("Topic", exact=True).input_value() == "/lens/compressed"
        filming.cancel()
        await asyncio.gather(filming, return_exceptions=True)
