"""`rce bench` in a process of its own."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from tests.support.e2e.real_platform import RCE


async def bench(seconds: float, *arguments: str) -> dict[str, Any]:
    """Run `rce bench ARGUMENTS --json`, for `seconds` at most, and return what it prints."""
    process = await asyncio.create_subprocess_exec(
        *(RCE, "bench", *arguments, "--json"), stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
    )
    output, errors = await asyncio.wait_for(process.communicate(), seconds)
    assert process.returncode == 0, errors.decode()
    printed: dict[str, Any] = json.loads(output)
    return printed
