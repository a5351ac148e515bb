"""The JavaScript client at a real platform, in Node."""

from __future__ import annotations

import asyncio
from pathlib import Path

from node import node_command
from real_platform import RealPlatform

TRIAL = Path(__file__).parent.parent / "js" / "node_trial.mjs"


async def test_the_client_in_node(platform: RealPlatform) -> None:
    process = await asyncio.create_subprocess_exec(
        *node_command(), str(TRIAL), platform.url, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    try:
        out, err = await asyncio.wait_for(process.communicate(), 120)
    finally:
        if process.returncode is None:
            process.kill()
    assert process.returncode == 0, err.decode()
    assert "an environment is created, used and destroyed" in out.decode()
