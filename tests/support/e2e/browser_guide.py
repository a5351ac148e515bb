"""The steps of docs/walkthrough-browser.md, done in a browser."""

from __future__ import annotations

import re
from contextlib import AsyncExitStack
from typing import Any

from rce.client import Robot
from tests.support.e2e.chromium import visit
from tests.support.e2e.real_platform import RealPlatform

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


async def follow(guide: str, page: Any, platform: RealPlatform) -> int:
    """Do all steps of a guide, given by its text, on a platform that has just been started; return their number."""
    steps = STEP.findall(guide)
    assert len(steps) == len(re.findall(r"^\d+\. ", guide, re.MULTILINE))
    async with AsyncExitStack() as stack:
        reader = Reader(page, platform, stack)
        for number, step in enumerate(steps):
            try:
                await reader.do(*step)
            except Exception as error:
                error.add_note(f"step {number + 1}: {step}")
                raise
    return len(steps)
