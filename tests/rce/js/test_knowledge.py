"""The JavaScript client of the knowledge service in Node, with a service in this process."""

from __future__ import annotations

import asyncio
from pathlib import Path

from tests.support.e2e.node import node_command
from tests.support.knowledge import Service
from tests.support.paths import TESTS

TIMEOUT = 60


async def test_client_in_node(tmp_path: Path) -> None:
    service = Service(tmp_path / "knowledge")
    await service.start()
    pipe = asyncio.subprocess.PIPE
    words = (*node_command(), str(TESTS / "js" / "knowledge.mjs"), service.root)
    process = await asyncio.create_subprocess_exec(*words, stdout=pipe, stderr=pipe)
    try:
        out, err = await asyncio.wait_for(process.communicate(), TIMEOUT)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
        await service.stop()
    assert (process.returncode, out) == (0, b"done\n"), err.decode()
