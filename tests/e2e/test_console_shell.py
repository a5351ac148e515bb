"""`rce env shell` on a pseudo-terminal, at a real platform."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.e2e.consoles import no_guest_interfaces, on_terminal, rce, user_environ
from tests.support.e2e.real_platform import RealPlatform, until

BRAIN = "shell_brain"
LINES = 200_000


@pytest.fixture
async def env(platform: RealPlatform, tmp_path: Path) -> AsyncIterator[dict[str, str]]:
    """Environment variables of a user with the environment `shell_brain`."""
    env = user_environ(tmp_path, platform.url)
    await rce("env", "create", BRAIN, env=env)
    yield env
    await rce("env", "delete", BRAIN, env=env)
    assert not platform.pid("rce_shell")


async def test_terminal_has_size_ctrl_c_and_exit_status(env: dict[str, str], platform: RealPlatform) -> None:
    await asyncio.to_thread(_use_shell, env, platform)
    await until(lambda: not platform.pid("rce_shell"), what="the node ends with its client")
    assert "status 3" in await rce("env", "shell", BRAIN, "echo status 3; exit 3", env=env, status=3)


def _use_shell(env: dict[str, str], platform: RealPlatform) -> None:
    """Type each line after the prompt: one that is typed earlier is echoed twice, by the terminal and by bash."""
    with on_terminal("env", "shell", BRAIN, env=env) as shell:
        shell.expect("[#$] ")
        shell.type("PS1=ready_; echo $((40 + 2)) $RCE_RUN\r")
        shell.expect("42 [0-9a-f]{32}")
        shell.expect("ready_")
        shell.type("stty size\r")
        shell.expect("24 80")
        shell.expect("ready_")
        shell.resize(50, 132)
        shell.type("until [ \"$(stty size)\" = '50 132' ]; do sleep 0.1; done; echo re''sized\r")
        shell.expect("resized")
        shell.expect("ready_")
        shell.type("sleep 1000\r")
        shell.expect("sleep 1000")
        _wait_for_program("sleep 1000", platform)
        shell.type("\x03")
        shell.expect("ready_")
        shell.type("echo status $?\r")
        shell.expect("status 130")
        shell.expect("ready_")
        shell.type(f"stty -onlcr; seq {LINES}; echo fin\r")
        shell.expect("fin\r\n")  # the echo of the typed line
        assert shell.expect("fin\n", 240).split()[:-1] == [str(number) for number in range(1, LINES + 1)]
        shell.expect("ready_")
        shell.type("exit 7\r")
        assert shell.wait() == 7


def _wait_for_program(command: str, platform: RealPlatform) -> None:
    """Wait until the program has the terminal.

    The echo of its command comes earlier. A Ctrl-C between the fork and the program's turn in the foreground reaches
    bash alone, which goes on waiting for the program.
    """
    end = time.monotonic() + 60
    while not platform.pid(command):
        assert time.monotonic() < end, f"{command} does not run"
        time.sleep(0.1)


async def test_program_ends_after_its_client_is_killed(env: dict[str, str], platform: RealPlatform) -> None:
    def vanish() -> None:
        with on_terminal("env", "shell", BRAIN, env=env) as shell:
            shell.expect("[#$] ")
            shell.type("sleep 1234\r")
            shell.expect("sleep 1234")
            _wait_for_program("sleep 1234", platform)
        # on_terminal has killed the client

    await asyncio.to_thread(vanish)
    await until(lambda: not platform.pid("sleep 1234"), 90, "the program ends")
    await until(lambda: not platform.pid("rce_shell"), what="the node ends")
    await no_guest_interfaces(env)
