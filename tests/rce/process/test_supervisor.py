"""Supervision of a child process."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from rce.errors import StartFailed
from rce.process import programs, supervisor
from rce.process.ready import Ready
from rce.process.supervisor import ManagedProcess

ANNOUNCE = (
    "from rce.process.ready import Ready, announce; announce(Ready('test', 'http://x/')); import time; time.sleep(60)"
)


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], ManagedProcess]:
    monkeypatch.setattr(programs, "command", lambda name: [sys.executable, "-c"])
    monkeypatch.setattr(supervisor, "RESTART_DELAY_MIN", 0.01)

    def make(program: str) -> ManagedProcess:
        return ManagedProcess("test", lambda: [program], {}, (tmp_path / "log").open("w"))

    return make


async def test_killed_process_is_restarted_until_it_is_stopped(make: Callable[[str], ManagedProcess]) -> None:
    process = make(ANNOUNCE)
    assert await process.start() == Ready("test", "http://x/")
    first = process.pid
    os.kill(first, signal.SIGKILL)
    async with asyncio.timeout(20):
        while process.pid == first:  # noqa: ASYNC110  # nothing announces the restart
            await asyncio.sleep(0.01)
    await process.stop()
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


async def test_process_that_ends_before_it_is_ready_fails_to_start(make: Callable[[str], ManagedProcess]) -> None:
    process = make("print('no announcement')")
    with pytest.raises(StartFailed, match="rce test did not start: it ended with status 0; see its output above"):
        await process.start()
    await process.stop()


async def test_start_times_out(make: Callable[[str], ManagedProcess], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "START_TIMEOUT", 0.1)
    process = make("import time; time.sleep(60)")
    with pytest.raises(StartFailed, match=r"it was not ready after 0.1 s; if this machine is busy, try again"):
        await process.start()
    await process.stop()
