"""Programs that tests start."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any


@asynccontextmanager
async def running(*words: str, **options: Any) -> AsyncIterator[asyncio.subprocess.Process]:
    """Run a program, and kill it at the end if it still runs.

    Args:
        words: The program and its arguments.
        options: As for `asyncio.create_subprocess_exec`.
    """
    process = await asyncio.create_subprocess_exec(*words, **options)
    try:
        yield process
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


async def run_program(*words: str, seconds: float, **options: Any) -> tuple[int, str, str]:
    """Run a program; return its status, its output and its errors.

    Raises:
        TimeoutError: It did not end in time.
    """
    pipe = asyncio.subprocess.PIPE
    async with running(*words, stdout=pipe, stderr=pipe, **options) as process:
        out, err = await asyncio.wait_for(process.communicate(), seconds)
    assert process.returncode is not None
    return process.returncode, out.decode(), err.decode()
