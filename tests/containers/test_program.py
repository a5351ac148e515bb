"""`python -P -m containers` as a process, which is killed and started again."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rce.control.calls.environments import StartEnvironment, StopEnvironment
from tests.support.containers.engine_contract import spec
from tests.support.containers.fake_master import WAIT, FakeMaster, joined
from tests.support.containers.process_world import STAND_IN, ProcessWorld

pytestmark = pytest.mark.slow  # starts the program many times

# Runs containers.__main__ with the stand-in instead of the Environment endpoint.
PROGRAM = """
import sys
from containers import __main__
from containers.process import engine
engine.COMMAND = {command!r}
sys.exit(__main__.main())
"""


class Program:
    """The task set's program with its own data directory."""

    def __init__(self, master: FakeMaster, directory: Path) -> None:
        self.directory = directory
        self.master = master

    async def start(self, *arguments: str) -> asyncio.subprocess.Process:
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-P", "-c", PROGRAM.format(command=STAND_IN)),
            *("--data-dir", str(self.directory), "--master", f"tcp:127.0.0.1:{self.master.number}", "--name", "m1"),
            *arguments,
            env={**os.environ, "RCE_TOKEN": "token"},
            stderr=subprocess.PIPE,
        )


@pytest.fixture
def program(master: FakeMaster, tmp_path: Path) -> Program:
    return Program(master, tmp_path)


@pytest.fixture
def world(tmp_path: Path) -> ProcessWorld:
    return ProcessWorld(tmp_path)


async def ended(process: asyncio.subprocess.Process) -> tuple[int | None, str]:
    _, errors = await asyncio.wait_for(process.communicate(), WAIT)
    return process.returncode, errors.decode()


async def test_environments_survive_a_killed_task_set(
    master: FakeMaster, program: Program, world: ProcessWorld
) -> None:
    first = await program.start()
    control = await joined(master)
    for run, name in enumerate(("ann/a", "ann/b", "ann/c"), 1):
        await control.call(StartEnvironment(spec(name, run)))
    first.send_signal(signal.SIGKILL)
    await ended(first)
    assert set(world.alive()) == {"ann/a", "ann/b", "ann/c"}
    await world.end("ann/b")

    second = await program.start()
    control = await joined(master)
    assert master.hellos[-1].token == "credential"
    assert master.hellos[-1].environments == {"ann/a": spec(run=1).run, "ann/c": spec(run=3).run}
    await world.end("ann/c")
    died = await asyncio.wait_for(master.deaths.get(), WAIT)
    assert (died.name, died.run) == ("ann/c", spec(run=3).run)
    assert "last words" in died.reason
    await control.call(StopEnvironment("ann/a"))
    assert world.remains() == set()
    second.send_signal(signal.SIGTERM)
    assert (await ended(second))[0] == 0


async def test_sigterm_keeps_or_stops_environments(master: FakeMaster, program: Program, world: ProcessWorld) -> None:
    first = await program.start()
    await (await joined(master)).call(StartEnvironment(spec()))
    first.send_signal(signal.SIGTERM)
    assert (await ended(first))[0] == 0
    assert set(world.alive()) == {"ann/map"}
    second = await program.start("--stop-environments")
    await joined(master)
    second.send_signal(signal.SIGINT)
    assert (await ended(second))[0] == 0
    assert world.remains() == set()


async def test_missing_package_directory_is_reported(program: Program, tmp_path: Path) -> None:
    status, errors = await ended(await program.start("--package-path", f"{tmp_path},{tmp_path / 'none'}"))
    assert status == 1
    assert f"setting package_path: no such directory: {tmp_path / 'none'}" in errors


async def test_data_directory_cannot_be_shared(master: FakeMaster, program: Program) -> None:
    first = await program.start()
    await joined(master)
    status, errors = await ended(await program.start())
    assert status == 1
    assert "another task set uses" in errors
    first.send_signal(signal.SIGTERM)
    await ended(first)


async def test_refused_token_ends_the_program(master: FakeMaster, program: Program) -> None:
    master.accepted.clear()
    status, errors = await ended(await program.start())
    assert status == 1
    assert "m1: this token is not known" in errors
    assert '"token"' not in errors


async def test_process_engine_refuses_a_remote_master(program: Program) -> None:
    status, errors = await ended(await program.start("--master", "tcp:192.0.2.1:8080"))
    assert status == 2
    assert "192.0.2.1" in errors
    assert "--allow-unisolated" in errors
