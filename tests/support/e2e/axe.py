"""axe-core in a page: violations of accessibility rules (WCAG 2.2 A and AA, and best practices)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

RUN = """async () => {
    const { violations } = await axe.run(document, { resultTypes: ["violations"] });
    const words = (each) => `${each.html.slice(0, 160)} ${each.failureSummary}`;
    return violations.map(({ id, nodes }) => `${id}: ${nodes.map(words).join(" | ")}`);
}"""


async def violations(page: Any) -> list[str]:
    """Return the violations on the page as it is now, or skip the test where axe-core is missing."""
    package = pytest.importorskip("axe_playwright_python", reason="needs axe-core: pip install '.[dev]'")
    script = next(Path(package.__file__).parent.rglob("axe.min.js"))
    if not await page.evaluate("'axe' in window"):
        await page.evaluate(script.read_text())
    found: list[str] = await page.evaluate(RUN)
    return found
