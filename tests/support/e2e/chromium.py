"""The system's Chromium by Playwright, and pages whose errors fail the test."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from tests.support.paths import ROOT

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
SCREENSHOTS = ROOT / "docs" / "screenshots"
NETWORK_CHANGED = "net::ERR_NETWORK_CHANGED"  # requests in progress fail when a container of another test starts
ENDED = re.compile(r"status of 404 .*/api/v1/environments/")  # a page asks for one that a test is removing
WIDE, NARROW = {"width": 1280, "height": 800}, {"width": 768, "height": 900}
PHONE = {"width": 390, "height": 844}


@asynccontextmanager
async def chromium() -> AsyncIterator[Any]:
    """Start a headless browser, or skip the test where there is none."""
    playwright = pytest.importorskip("playwright.async_api", reason="needs Playwright: pip install '.[dev]'")
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("no Chromium: install chromium to run this")
    async with playwright.async_playwright() as started:
        options = ["--enable-unsafe-swiftshader"]  # WebGL without a GPU
        options += ["--no-sandbox"] if os.geteuid() == 0 else []
        browser = await started.chromium.launch(executable_path=program, args=options)
        yield browser
        await browser.close()


@asynccontextmanager
async def open_page(browser: Any, **options: Any) -> AsyncIterator[tuple[Any, list[str]]]:
    """Open a page in a context of its own. Yields it and the errors that it logs; none may be left at the end."""
    context = await browser.new_context(**{"viewport": WIDE, **options})
    page = await context.new_page()
    page.set_default_timeout(60_000)
    errors: list[str] = []

    def record_error(message: Any) -> None:
        text = f"{message.text} ({message.location.get('url')})"
        if message.type == "error" and NETWORK_CHANGED not in text and not ENDED.search(text):
            errors.append(text)

    page.on("console", record_error)
    page.on("pageerror", lambda error: errors.append(str(error)))
    try:
        yield page, errors
        assert errors == []
    except BaseException as error:
        error.add_note(f"{page.url}\n{await page.inner_text('body')}\n{errors}")
        raise
    finally:
        await context.close()


async def visit(page: Any, url: str) -> None:
    """Open a URL, again as long as the network of this machine changes meanwhile."""
    interrupted = True

    def note(request: Any) -> None:
        nonlocal interrupted
        interrupted = interrupted or request.failure == NETWORK_CHANGED

    page.on("requestfailed", note)
    while interrupted:
        interrupted = False
        try:
            await page.goto(url)
        except Exception as error:
            if NETWORK_CHANGED not in str(error):
                raise
            interrupted = True
    page.remove_listener("requestfailed", note)


async def sign_in(page: Any, url: str, user: str, password: str) -> None:
    """Sign in, which leads to the graph."""
    await visit(page, f"{url}ui/")
    await page.get_by_label("User").fill(user)
    await page.get_by_label("Password").fill(password)
    await page.get_by_role("button", name="Sign in").click()
    await page.get_by_role("heading", name="Robots and environments").wait_for()


async def screenshot(page: Any, name: str) -> None:
    """Save a screenshot for the documentation, if RCE_SCREENSHOTS is set."""
    if os.environ.get("RCE_SCREENSHOTS"):
        SCREENSHOTS.mkdir(exist_ok=True)
        await page.screenshot(path=SCREENSHOTS / f"{name}.png")
