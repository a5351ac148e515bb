"""The JavaScript client of the knowledge service in Node, with a service in this process."""

from __future__ import annotations

from pathlib import Path

from tests.support.e2e.node import run_script
from tests.support.knowledge import Service
from tests.support.paths import TESTS

TIMEOUT = 60


async def test_client_in_node(tmp_path: Path) -> None:
    async with Service(tmp_path / "knowledge") as service:
        status, out, err = await run_script(str(TESTS / "js" / "knowledge.mjs"), service.root, timeout=TIMEOUT)
    assert (status, out) == (0, "done\n"), err
