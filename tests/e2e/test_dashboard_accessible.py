"""All pages of the dashboard: nothing is cut off, axe-core finds no violation, and the keyboard suffices."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from functools import reduce
from pathlib import Path
from typing import Any

import pytest

from rce.protocol.messages import AddInterface
from tests.support.e2e.axe import violations
from tests.support.e2e.chromium import NARROW, PHONE, WIDE, chromium, open_page, sign_in, visit
from tests.support.e2e.real_platform import USER, RealPlatform
from tests.support.e2e.squeezed import squeezed

STRING = "std_msgs/String"
OWN = (
    *(
        "#/",
        "#/environments/{user}/ward",
        "#/topics/{user}/ward?topic=/heard",
        "#/map/{user}/ward",
        "#/image/{user}/ward",
    ),
    *(
        "#/space/{user}/ward",
        "#/panels",
        "#/recordings",
        "#/bags",
        "#/knowledge",
        "#/services",
        "#/packages",
        "#/parameters/{user}/ward",
    ),
    *("#/trace/{user}/ward/heard", "#/events", "#/keys", "#/audit"),
    *("examples/joystick.html", "terminal.html#{user}/ward"),
)
SOME = {"#/", "#/environments/{user}/ward", "#/topics/{user}/ward?topic=/heard", "#/keys"}  # with all kinds of elements
FORMS = {"light": (WIDE, "light"), "dark": (WIDE, "dark"), "narrow": (NARROW, "light"), "phone": (PHONE, "dark")}
NAME = """(({ ariaLabel, labels, innerText }) => ariaLabel || labels?.[0]?.innerText || innerText)
(document.activeElement)"""
"""Script that returns the name of what has the focus."""
ADMINISTRATORS = ("#/machines", "#/users", "#/users/{user}")


@pytest.fixture(scope="module")
async def browser() -> AsyncIterator[Any]:
    async with chromium() as browser:
        yield browser


async def check(page: Any, name: str, pictures: Path, *, thorough: bool) -> None:
    """Check a page in all forms, `thorough` with axe-core, and leave pictures for a person to look at."""
    for form, (size, colors) in FORMS.items():
        await page.set_viewport_size(size)
        await page.emulate_media(color_scheme=colors)
        await page.screenshot(path=pictures / f"{re.sub('[^a-z]+', '-', name).strip('-') or 'graph'}-{form}.png")
        assert await squeezed(page) == [], (name, form)
        if form == "light" or thorough:
            assert await violations(page) == [], (name, form)


async def check_pages(page: Any, url: str, pages: tuple[str, ...], pictures: Path) -> None:
    for each in pages:
        await visit(page, "about:blank")
        await visit(page, f"{url}ui/{each.format(user=USER)}")
        await page.get_by_role("heading", level=1).wait_for()
        await page.wait_for_load_state("networkidle") if each.startswith("examples") else None
        await check(page, each, pictures, thorough=each in SOME)


async def test_pages_have_room_and_no_violations(browser: Any, platform: RealPlatform, tmp_path: Path) -> None:
    async with platform.robot("nurse") as robot, robot.environment("ward") as ward:
        await ward.add_node("echo", "rce_demo", "echo.py")
        await robot.configure(AddInterface("ward", "heard", "SubscriberInterface", STRING, "/heard"))
        async with open_page(browser) as (page, _):
            await visit(page, f"{platform.url}ui/")
            await page.get_by_role("heading", name="Sign in").wait_for()
            await check(page, "sign-in", tmp_path, thorough=True)
            await sign_in(page, platform.url, USER, USER)
            await check_pages(page, platform.url, OWN, tmp_path)
            await visit(page, f"{platform.url}ui/#/")
            await page.get_by_role("button", name="New environment").click()
            await page.get_by_role("dialog").wait_for()
            await check(page, "dialog", tmp_path, thorough=True)
        async with open_page(browser) as (page, _):
            await sign_in(page, platform.url, "admin", "admin")
            await check_pages(page, platform.url, ADMINISTRATORS, tmp_path)


async def tab_to(page: Any, name: str) -> None:
    """Wait for the element of this name, and press Tab until it has the focus."""
    roles = ("button", "link", "textbox", "combobox")
    found = [page.get_by_role(role, name=name) for role in roles]
    await reduce(lambda one, other: one.or_(other), found).first.wait_for()
    for _ in range(80):
        await page.keyboard.press("Tab")
        focused = await page.evaluate(NAME)
        if focused.strip().startswith(name):
            return
    raise AssertionError(f"Tab does not lead to {name}")


async def test_everything_is_reached_by_the_keyboard(browser: Any, platform: RealPlatform) -> None:
    """Sign in, create an environment, start a node in it, read a topic, stop the environment: without a mouse."""
    async with open_page(browser) as (page, _):
        keyboard = page.keyboard
        await visit(page, f"{platform.url}ui/")
        await page.get_by_role("heading", name="Sign in").wait_for()
        await keyboard.type(USER)  # the focus is on the first field
        await tab_to(page, "Password")
        await keyboard.type(USER)
        await keyboard.press("Enter")
        await page.get_by_role("heading", name="Robots and environments").wait_for()
        await tab_to(page, "New environment")
        await keyboard.press("Enter")
        await page.get_by_role("dialog").wait_for()
        await keyboard.type("typed")
        await keyboard.press("Enter")
        await page.get_by_role("dialog").wait_for(state="detached")
        await page.get_by_role("link", name="typed").wait_for()
        await tab_to(page, "typed")
        await keyboard.press("Enter")
        await page.get_by_role("heading", name="typed").wait_for()
        await tab_to(page, "Start node")
        await keyboard.press("Enter")
        for label, text in (("Name", "echo"), ("ROS package", "rce_demo"), ("Executable", "echo.py")):
            if label != "Name":  # the first field has the focus
                await tab_to(page, label)
            else:
                await page.get_by_role("dialog").wait_for()
            await keyboard.type(text)
        await keyboard.press("Enter")
        await page.get_by_role("dialog").wait_for(state="detached")
        await page.get_by_role("cell", name="rce_demo echo.py").wait_for()
        await tab_to(page, "Topics and services")
        await keyboard.press("Enter")
        await page.get_by_role("link", name="/heard").wait_for()
        await tab_to(page, "/heard")
        await keyboard.press("Enter")
        await page.get_by_role("button", name="Publish").wait_for()
        await page.go_back()
        await page.go_back()
        await tab_to(page, "Stop environment")
        await keyboard.press("Enter")
        await page.get_by_role("dialog").wait_for()
        await tab_to(page, "Stop environment")
        await keyboard.press("Enter")
        await page.get_by_role("heading", name="Robots and environments").wait_for()
