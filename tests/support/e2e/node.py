"""Node.js with a WebSocket."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from tests.support.programs import run_program


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
    return await run_program(*node_command(), *words, seconds=timeout)
