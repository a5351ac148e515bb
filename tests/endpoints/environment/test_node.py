"""The process of a node: its start, its output and its end, with programs that are no nodes."""

from __future__ import annotations

import asyncio
import errno
import os
import signal
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest

from endpoints.environment import node
from endpoints.environment.node import NodeProcess
from endpoints.environment.output_log import OutputLog
from rce.control.calls.endpoints import NodeSpec
from rce.errors import StartFailed
from tests.support.endpoints.environment_driver import LIMIT, is_alive

SPEC = NodeSpec("brain", "p", "e")
QUICK_STEPS = ((signal.SIGINT, 0.2), (signal.SIGTERM, 0.2), (signal.SIGKILL, 10.0))
Start = Callable[..., Awaitable[NodeProcess]]


@pytest.fixture
def ended() -> list[int]:
    """Exit statuses that were reported."""
    return []


@pytest.fixture
async def start(tmp_path: Path, ended: list[int]) -> AsyncIterator[Start]:
    started: list[NodeProcess] = []

    async def make(*command: str, **variables: str) -> NodeProcess:
        made = await NodeProcess.start(
            SPEC,
            command,
            {"PATH": os.environ["PATH"], **variables},
            tmp_path,
            OutputLog(tmp_path / "log"),
            lambda _, status: ended.append(status),
        )
        started.append(made)
        return made

    yield make
    for each in started:
        await each.stop()


async def line(process: NodeProcess, text: str) -> str:
    """Return the first line of the output that contains `text`, once there is one."""
    async with asyncio.timeout(LIMIT):
        position = ""
        while True:
            lines, position = await process.output.wait_since(position, 1)
            for each in lines:
                if text in each:
                    return each


async def test_status_and_output_of_process_that_ends(start: Start, ended: list[int], tmp_path: Path) -> None:
    process = await start("sh", "-c", "pwd; echo $WORD; echo error >&2; exit 3", WORD="variable")
    assert await asyncio.wait_for(process.over, LIMIT) == 3
    assert (ended, process.stopping) == ([3], False)
    assert process.output.last_lines(10) == [str(tmp_path), "variable", "error"]


async def test_node_whose_output_cannot_be_stored_is_not_blocked(
    start: Start, ended: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: OutputLog, part: bytes) -> int:
        raise OSError(errno.ENOSPC, "no space")

    monkeypatch.setattr(OutputLog, "_append", fail)
    process = await start("sh", "-c", "head -c 1000000 /dev/zero; exit 3")  # more than a pipe holds
    assert await asyncio.wait_for(process.over, LIMIT) == 3


@pytest.mark.parametrize("command", ["/nowhere/node", "/etc/passwd"])
async def test_command_that_cannot_be_executed_is_rejected(start: Start, ended: list[int], command: str) -> None:
    with pytest.raises(StartFailed, match=f"node brain did not start: {command}: "):
        await start(command)
    assert ended == []


async def test_missing_directory_is_rejected(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(StartFailed, match="node brain did not start"):
        await NodeProcess.start(
            SPEC, ["true"], {}, tmp_path / "gone", OutputLog(tmp_path / "log"), lambda *_: pytest.fail("has not run")
        )
    assert len(os.listdir("/proc/self/fd")) <= before + 1, "the pipe of the report is closed; the log may be open"


async def test_stopped_process_gets_sigint_first(
    start: Start, ended: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "STOP_STEPS", ((signal.SIGINT, LIMIT), (signal.SIGKILL, LIMIT)))
    process = await start("sh", "-c", "trap 'exit 5' INT; echo ready; while true; do sleep 0.01; done")
    await line(process, "ready")
    await process.stop()
    assert (process.stopping, ended) == (True, [5])
    await process.stop()  # it is over


async def test_process_that_ignores_signals_is_killed(
    start: Start, ended: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "STOP_STEPS", QUICK_STEPS)
    process = await start("sh", "-c", "trap '' INT TERM; echo ready; while true; do sleep 0.01; done")
    await line(process, "ready")
    await process.stop()
    assert ended == [-signal.SIGKILL]


async def test_processes_that_a_node_leaves_behind_are_killed(start: Start) -> None:
    process = await start("sh", "-c", "sleep 1000 & echo child $!")
    child = int((await line(process, "child")).split()[1])
    assert await asyncio.wait_for(process.over, LIMIT) == 0
    assert not is_alive(child)


async def test_open_output_of_other_process_is_not_awaited_forever(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(node, "OUTPUT_TIMEOUT", 0.05)
    process = await start("sh", "-c", "setsid sleep 1000 & echo child $!; until [ -e go ]; do sleep 0.01; done")
    child = int((await line(process, "child")).split()[1])
    (tmp_path / "go").touch()
    try:
        assert await asyncio.wait_for(process.over, LIMIT) == 0
    finally:
        if is_alive(child):
            os.kill(child, signal.SIGKILL)
