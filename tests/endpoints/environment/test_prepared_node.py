"""The interpreter that becomes the first node: when it is taken, and what its program sees."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from endpoints.environment import prepared_node
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
    await spare.discard()


async def test_it_is_given_away_once(spare: Spare, tmp_path: Path) -> None:
    variables = {"A": "1", LIBRARIES: f"{sys.prefix}/other"}
    assert spare.suits([sys.executable, "node.py"], variables)
    taken = spare.take([sys.executable, "node.py"], variables, tmp_path)
    out, _ = await taken.communicate()
    assert b'"command": ["node.py"]' in out
    assert not spare.suits([sys.executable, "node.py"], {})


@pytest.mark.parametrize(
    ("command", "variables"), [(["/bin/node"], {}), ([sys.executable, "n.py"], {LIBRARIES: "/users/lib"})]
)
async def test_it_cannot_be_every_node(spare: Spare, command: list[str], variables: dict[str, str]) -> None:
    assert not spare.suits(command, variables)


async def test_one_that_is_not_taken_ends_with_its_standard_input(spare: Spare) -> None:
    waiting = spare._process
    assert waiting is not None
    await spare.discard()
    assert waiting.returncode == 0
    await spare.discard()


async def test_one_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prepared_node, "END_TIMEOUT", 0.01)
    words = ("tail", "-f", "/dev/null")
    deaf = await asyncio.create_subprocess_exec(*words, stdin=asyncio.subprocess.PIPE)
    await Spare(deaf).discard()
    assert deaf.returncode == -signal.SIGKILL


async def test_one_that_has_ended_suits_no_node(spare: Spare) -> None:
    assert spare._process is not None
    spare._process.kill()
    await spare._process.wait()
    assert not spare.suits([sys.executable, "n.py"], {})


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
