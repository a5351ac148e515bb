"""Programs that are started again."""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncIterator
from io import TextIOWrapper
from pathlib import Path

import pytest

from rce.bench.standby import programs
from rce.bench.standby.programs import Program

PATIENCE = 20.0
WAITING = "import time; print('up', flush=True); time.sleep(1000)"


@pytest.fixture
def log(tmp_path: Path) -> TextIOWrapper:
    return (tmp_path / "log").open("w")


class Lines(asyncio.Queue[str]):
    async def next(self) -> str:
        return await asyncio.wait_for(self.get(), PATIENCE)


@pytest.fixture
async def running(log: TextIOWrapper, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[tuple[Program, Lines]]:
    monkeypatch.setattr(programs, "RESTART_DELAY", 0.01)
    lines = Lines()
    program = Program("waiting", lambda: [sys.executable, "-c", WAITING], {}, log, lines.put_nowait)
    program.start()
    yield program, lines
    await program.stop()


async def test_killed_program_is_started_again(running: tuple[Program, Lines]) -> None:
    program, lines = running
    assert await lines.next() == "up\n"
    first = program.pid
    program.signal(signal.SIGKILL)
    assert await lines.next() == "up\n"
    assert program.pid != first
    assert (program.starts, program.ended) == (2, 1)


async def test_held_program_is_started_when_it_is_released(running: tuple[Program, Lines]) -> None:
    program, lines = running
    await lines.next()
    program.hold()
    program.signal(signal.SIGKILL)
    while not program.ended:  # noqa: ASYNC110  # it has no event of its own
        await asyncio.sleep(0.001)
    assert lines.empty()
    assert program.pid == 0
    program.release()
    assert await lines.next() == "up\n"
