"""Elements of a page that have no room."""

from __future__ import annotations

import asyncio
from typing import Any

TRIES, INTERVAL = 100, 0.1  # seconds

RUN = """() => {
    const all = (name) => [...document.querySelectorAll(name)];
    const cut = (each) => each.getBoundingClientRect().left < 0 || each.getBoundingClientRect().right > innerWidth;
    const broken = (each) => each.getClientRects().length > 1;
    const found = [...all("main button, main a").filter(cut), ...all("main td .mono:not(.any)").filter(broken)];
    const wide = document.documentElement.scrollWidth > innerWidth ? ["the page"] : [];
    const current = all("#bar [aria-current]").filter(cut);
    return [...wide, ...[...found, ...current].map((each) => each.textContent)];
}"""


async def squeezed(page: Any) -> list[str]:
    """Return the texts of elements that are cut off or broken into lines, after the page has adapted to its size."""
    found: list[str] = []
    for _ in range(TRIES):
        found = await page.evaluate(RUN)
        if not found:
            break
        await asyncio.sleep(INTERVAL)
    return found
