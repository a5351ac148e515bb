"""The JavaScript client in Node, at the fake platform; tests/e2e/test_javascript.py has it at a real one."""

from __future__ import annotations

import asyncio

import pytest

from tests.support.e2e.node import node_command
from tests.support.fake_platform import FakePlatform
from tests.support.paths import TESTS

NEED_REAL_PLATFORM = (
    "refused robots get the reason",
    "environment is created, used and destroyed",
    "goals end as their server says",
)
TIMEOUT = 60


@pytest.mark.slow
async def test_client_contract() -> None:
    async with FakePlatform() as platform:
        process = await asyncio.create_subprocess_exec(
            *node_command(),
            str(TESTS / "js" / "run_in_node.mjs"),
            platform.url,
            *NEED_REAL_PLATFORM,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        try:
            out, err = await asyncio.wait_for(process.communicate(), TIMEOUT)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
    assert process.returncode == 0, err.decode()
    assert len(out.splitlines()) >= 8
