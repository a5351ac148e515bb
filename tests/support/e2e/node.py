"""Node.js with a WebSocket."""

from __future__ import annotations

import asyncio
import re
import shutil
import subprocess

import pytest


def node_command() -> list[str]:
    """Return the command that runs scripts, or skip the test where there is none."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no Node.js: install nodejs to run this")
    version = subprocess.run([node, "--version"], capture_output=True, text=True, check=True).stdout
    numbers = tuple(map(int, re.findall(r"\d+", version)))
    if numbers < (20, 10):
        pytest.skip(f"Node.js {version.strip()} has no WebSocket: 20.10 or later is needed to run this")
    return [node] if numbers >= (22,) else [node, "--experimental-websocket"]


async def run_script(*words: str, timeout: float) -> tuple[int, str, str]:  # noqa: ASYNC109
    """Run a script in Node.js; return its exit status and what it printed to standard output and error."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(*node_command(), *words, stdout=pipe, stderr=pipe)
    try:
        out, err = await asyncio.wait_for(process.communicate(), timeout)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert process.returncode is not None
    return process.returncode, out.decode(), err.decode()
