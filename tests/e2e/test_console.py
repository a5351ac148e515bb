"""The console at a real platform: data of environments, logs, the interactive shell, completion in other shells."""

from __future__ import annotations

import asyncio
import shutil
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from consoles import on_terminal, rce, surroundings
from real_platform import RCE, RealPlatform

BRAIN = "console_brain"


@pytest.fixture(scope="module")
async def env(platform: RealPlatform, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[dict[str, str]]:
    """Surroundings with an environment `console_brain` and in it the node `echo`."""
    env = surroundings(tmp_path_factory.mktemp("home"), platform.url)
    await rce("env", "create", BRAIN, env=env)
    await rce("node", "start", BRAIN, "echo", "rce_demo", "echo", env=env)
    yield env
    await rce("env", "delete", BRAIN, env=env)


async def test_topics_as_with_ros2(env: dict[str, str]) -> None:
    say, heard, text = f"{BRAIN}/say", f"{BRAIN}/heard", "std_msgs/String"
    listening = asyncio.create_task(rce("topic", "echo", "--once", heard, text, env=env))
    saying = asyncio.create_task(rce("topic", "pub", "-r", "20", "-t", "100", say, text, "{data: grüezi}", env=env))
    assert await listening == "data: grüezi\n---\n"
    rates = await rce("console", given=f"topic hz {heard}\n", env=env, status=None, seconds=6)
    assert "average rate: " in rates
    await saying
    listed = await rce("topic", "list", BRAIN, env=env)
    assert "/heard" in listed
    assert "std_msgs/msg/String" in listed
    assert "console_" not in await rce("interface", "list", BRAIN, env=env)


async def test_a_service_is_called(env: dict[str, str]) -> None:
    service = f"{BRAIN}/echo/get_parameters"
    answer = await rce("service", "call", service, "rcl_interfaces/GetParameters", "{names: [use_sim_time]}", env=env)
    assert "bool_value: false" in answer
    told = await rce("service", "call", f"{BRAIN}/nowhere", env=env, status=1)
    assert "there is no service /nowhere" in told


async def test_logs_are_followed(env: dict[str, str]) -> None:
    await rce("node", "start", BRAIN, "odd", "rce_demo", "echo", "--args", "--ros-args --log-level debug", env=env)
    told = await rce("node", "logs", BRAIN, "odd", "-f", env=env, status=None, seconds=6)
    assert "[DEBUG]" in told or "odd" in told
    await rce("node", "stop", BRAIN, "odd", env=env)


async def test_the_interactive_console(env: dict[str, str]) -> None:
    await asyncio.to_thread(_converse, env)


def _converse(env: dict[str, str]) -> None:
    with on_terminal("console", env=env) as console:
        console.until(">")
        console.type("env sho\t")
        console.until("w")
        console.type(" con\t")
        console.until("sole_brain")
        console.type("\r")
        console.until("containerTag +console_brain")
        console.type("robot lst\r")
        console.until("there is no command `robot lst`")
        console.type("watch -n 0.2 node list console_brain\r")
        console.until("rce_demo/echo")
        console.until("rce_demo/echo")
        console.type("\x03")
        console.until("[0-9]>")
        console.type("exit\r")
        console.wait()


BASH = """
source <("{rce}" completion bash)
COMP_WORDS=("{rce}" {words}); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1)); _rce; echo "${{COMPREPLY[@]}}"
"""


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("env cr", "create"),
        ("env show console_b", BRAIN),
        ("node list --js", "--json"),
        (f"topic echo {BRAIN}/say", f"{BRAIN}/say"),
    ],
)
async def test_bash_completes(env: dict[str, str], words: str, expected: str) -> None:
    script = BASH.format(rce=RCE, words=words)
    done = await asyncio.to_thread(
        subprocess.run, ["bash", "-c", script], env=env, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.split() == [expected], done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
async def test_completion_scripts_are_scripts(env: dict[str, str], tmp_path: Path, shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    script = tmp_path / "script"
    script.write_text(await rce("completion", shell, env=env))
    done = await asyncio.to_thread(subprocess.run, [shell, "-n", str(script)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
