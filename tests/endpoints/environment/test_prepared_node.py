"""The interpreter that becomes the first node: when it is taken, and what its program sees."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from endpoints.environment.prepared_node import LIBRARIES, Spare, become

PROGRAM = "import os, sys; print(sys.argv[1:], os.environ['NEW'], 'OLD' in os.environ, os.getcwd(), __name__)"


async def process() -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        "cat", stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, env={}
    )


@pytest.fixture
async def spare() -> AsyncIterator[Spare]:
    spare = Spare(await process(), {LIBRARIES: f"{sys.prefix}/lib"})
    yield spare
    spare.discard()


async def test_it_is_given_away_once(spare: Spare, tmp_path: Path) -> None:
    taken = spare.take([sys.executable, "node.py"], {"A": "1", LIBRARIES: f"{sys.prefix}/other"}, tmp_path)
    assert taken is not None
    out, _ = await taken.communicate()
    assert b'"command": ["node.py"]' in out
    assert spare.take([sys.executable, "node.py"], {}, tmp_path) is None


@pytest.mark.parametrize(
    ("command", "variables"), [(["/bin/node"], {}), ([sys.executable, "n.py"], {LIBRARIES: "/users/lib"})]
)
async def test_it_cannot_be_every_node(
    spare: Spare, command: list[str], variables: dict[str, str], tmp_path: Path
) -> None:
    assert spare.take(command, variables, tmp_path) is None


async def test_one_that_has_ended_is_not_taken(spare: Spare, tmp_path: Path) -> None:
    assert spare._process is not None
    spare._process.kill()
    await spare._process.wait()
    assert spare.take([sys.executable, "n.py"], {}, tmp_path) is None


def test_program_runs_as_if_it_was_started(tmp_path: Path) -> None:
    program = tmp_path / "node.py"
    program.write_text(PROGRAM)
    order = {"command": [str(program), "-x"], "variables": {"NEW": "1"}, "directory": str(tmp_path)}
    code = f"from endpoints.environment.prepared_node import become; become({order!r})"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, "OLD": "1"}
    )
    assert done.stdout == f"['-x'] 1 False {tmp_path} __main__\n"
    assert callable(become)
