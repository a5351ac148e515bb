"""The steps of docs/walkthrough-browser.md on a fresh platform."""

from __future__ import annotations

import re
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

from rce.client import Robot
from tests.support.e2e.chromium import chromium, open_page, visit
from tests.support.e2e.real_platform import RealPlatform
from tests.support.paths import ROOT

GUIDE = ROOT / "docs" / "walkthrough-browser.md"
STEP = re.compile(r"^\d+\. (\w[\w ]*?) \*\*(.+?)\*\*(?: (?:with )?`(.+)`)?$", re.MULTILINE)
PRINTED = "the password that was printed"


class Reader:
    """A user who follows the guide."""

    def __init__(self, page: Any, platform: RealPlatform, stack: AsyncExitStack) -> None:
        self.page = page
        self._platform = platform
        self._stack = stack
        self._key = ""

    async def do(self, verb: str, what: str, value: str) -> None:
        page = self.page
        # Dialogs come after the page in the document.
        field = page.get_by_label(re.compile(rf"^{re.escape(what)}( |$)")).last
        match verb:
            case "Open":
                await visit(page, self._platform.url.rstrip("/") + what)
            case "Fill in":
                await field.fill(password(self._platform) if value == PRINTED else value)
            case "Choose":
                await field.select_option(value)
            case "Click":
                button, link = (page.get_by_role(role, name=what, exact=True) for role in ("button", "link"))
                await button.or_(link).last.click()
            case "See":
                await page.get_by_text(what, exact=True).first.wait_for()
            case "Keep":
                self._key = await page.locator(".secret").inner_text()
            case "Connect":
                robot = Robot(self._platform.url, user="alice", robot=what, key=self._key)
                await self._stack.enter_async_context(robot)
            case _:
                raise AssertionError(f"nobody knows how to {verb}")


def password(platform: RealPlatform) -> str:
    """Return the administrator's password, which the first start prints."""
    found = re.search(r"with password '([^']+)'", platform.output)
    assert found, platform.output
    return found[1]


async def test_walkthrough(tmp_path: Path) -> None:
    steps = STEP.findall(GUIDE.read_text())
    assert len(steps) == len(re.findall(r"^\d+\. ", GUIDE.read_text(), re.MULTILINE)) > 30
    async with (
        chromium() as browser,
        RealPlatform(tmp_path, dev=False) as platform,
        open_page(browser) as (page, _),
        AsyncExitStack() as stack,
    ):
        reader = Reader(page, platform, stack)
        for number, step in enumerate(steps):
            try:
                await reader.do(*step)
            except Exception as error:
                error.add_note(f"step {number + 1}: {step}")
                raise
