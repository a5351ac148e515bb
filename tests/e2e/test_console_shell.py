"""`rce env shell`: a real terminal in an environment."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from consoles import on_terminal, rce, surroundings
from real_platform import RealPlatform, until

BRAIN = "shell_brain"
LINES = 200_000


@pytest.fixture
async def env(platform: RealPlatform, tmp_path: Path) -> AsyncIterator[dict[str, str]]:
    """Surroundings with an environment `shell_brain`."""
    env = surroundings(tmp_path, platform.url)
    await rce("env", "create", BRAIN, env=env)
    yield env
    await rce("env", "delete", BRAIN, env=env)
    assert not platform.pid("rce_shell")


async def test_a_terminal_in_an_environment(env: dict[str, str], platform: RealPlatform) -> None:
    await asyncio.to_thread(_converse, env)
    await until(lambda: not platform.pid("rce_shell"), what="the node ends with its client")
    assert "status 3" in await rce("env", "shell", BRAIN, "echo status 3; exit 3", env=env, status=3)


def _converse(env: dict[str, str]) -> None:
    with on_terminal("env", "shell", BRAIN, env=env) as shell:
        shell.until("[#$] ")
        shell.type("PS1=ready_; echo $((40 + 2)) $RCE_RUN\r")
        shell.until("42 [0-9a-f]{32}")
        shell.until("ready_")
        shell.type("stty size\r")
        shell.until("24 80")
        shell.resize(50, 132)
        shell.type("until [ \"$(stty size)\" = '50 132' ]; do sleep 0.1; done; echo re''sized\r")
        shell.until("resized")
        shell.type("sleep 1000\r")
        shell.until("sleep 1000")
        shell.type("\x03")
        shell.until("ready_")
        shell.type("echo status $?\r")
        shell.until("status 130")
        shell.type(f"stty -onlcr; seq {LINES}; echo fin\r")
        shell.until("fin\r\n")  # as typed
        assert shell.until("fin\n").split()[:-1] == [str(number) for number in range(1, LINES + 1)]
        shell.type("exit 7\r")
        assert shell.wait() == 7


async def test_it_ends_when_its_client_vanishes(env: dict[str, str], platform: RealPlatform) -> None:
    def vanish() -> None:
        with on_terminal("env", "shell", BRAIN, env=env) as shell:
            shell.until("[#$] ")
            shell.type("sleep 1234\r")
            shell.until("sleep 1234")
            end = time.monotonic() + 20
            while not platform.pid("sleep 1234"):  # what was typed is seen before it runs
                assert time.monotonic() < end
                time.sleep(0.1)
        # closed now, and with it killed

    await asyncio.to_thread(vanish)
    await until(lambda: not platform.pid("sleep 1234"), 40, "the program ends")
    await until(lambda: not platform.pid("rce_shell"), 5, "the node ends")
    assert "@" not in await rce("interface", "list", BRAIN, env=env), "its guest took all with it"
