"""The console at a real platform: data of environments, logs, the interactive console, completion in shells."""

from __future__ import annotations

import asyncio
import base64
import http.client
import json
import shutil
import subprocess
import urllib.request
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.e2e.consoles import no_guest_interfaces, on_terminal, rce, running, user_environ
from tests.support.e2e.real_platform import RCE, USER, RealPlatform

BRAIN = "console_brain"


@pytest.fixture(scope="module")
async def env(platform: RealPlatform, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[dict[str, str]]:
    """Environment variables of a user with the environment `console_brain`, in which the node `echo` runs."""
    env = user_environ(tmp_path_factory.mktemp("home"), platform.url)
    await rce("env", "create", BRAIN, env=env)
    await rce("node", "start", BRAIN, "echo", "rce_demo", "echo", env=env)
    async with asyncio.timeout(120):
        while "/heard" not in await rce("topic", "list", BRAIN, env=env):
            pass
    yield env
    await rce("env", "delete", BRAIN, env=env)


async def test_topic_echo_hz_pub_and_list(env: dict[str, str]) -> None:
    say, heard, text = f"{BRAIN}/say", f"{BRAIN}/heard", "std_msgs/String"
    async with running("topic", "pub", "-r", "20", say, text, "{data: grüezi}", env=env) as saying:
        assert await rce("topic", "echo", "--once", heard, text, env=env) == "data: grüezi\n---\n"
        async with running("topic", "hz", heard, env=env) as rates:
            await rates.expect_line("average rate: ")
            assert await rates.interrupt() == 130
        assert await saying.interrupt() == 130
    counted = await rce("topic", "pub", "-r", "20", "-t", "3", say, text, "{data: hi}", env=env)
    assert counted.count("publishing #") == 3
    listed = await rce("topic", "list", BRAIN, env=env)
    assert "/heard" in listed
    assert "std_msgs/msg/String" in listed
    await no_guest_interfaces(env)


@pytest.mark.parametrize(
    ("type_name", "message", "reason"),
    [
        ("std_msgs/String", "{data: 5}", "std_msgs/msg/String data: Expected str, got int"),
        ("std_msgs/String", "{dat: hi}", "did you mean data?"),
        ("std_msgs/Strang", "{data: hi}", "has type std_msgs/msg/String, not std_msgs/Strang"),
        ("geometry_msgs/Twist", "{linear: {x: 1}}", "has type std_msgs/msg/String, not geometry_msgs/Twist"),
    ],
)
async def test_wrong_message_is_not_published(env: dict[str, str], type_name: str, message: str, reason: str) -> None:
    report = await rce("topic", "pub", f"{BRAIN}/say", type_name, message, env=env, status=1)
    assert reason in report


async def test_service_call_prints_the_response(env: dict[str, str]) -> None:
    service = f"{BRAIN}/echo/get_parameters"
    words = ("service", "call", service, "rcl_interfaces/GetParameters", "{names: [use_sim_time]}")
    while "did not answer" in (answer := await rce(*words, env=env, status=None)):
        pass  # the answer is lost if DDS discovery has not finished
    assert "bool_value: false" in answer
    report = await rce("service", "call", f"{BRAIN}/nowhere", env=env, status=1)
    assert "there is no service /nowhere" in report


async def test_logs_and_events_are_followed(env: dict[str, str], platform: RealPlatform) -> None:
    """By the console and as server-sent events of the API, in order."""
    loud, text = ("node", "start", BRAIN, "loud", "Relay", "loud.py"), "std_msgs/String"
    async with running("events", env=env) as events:
        await rce(*loud, env=env)
        async with running("node", "logs", BRAIN, "loud", "-f", env=env) as log:
            await log.expect_line("^listening$")
            stream = await asyncio.to_thread(_follow, f"{platform.url}api/v1/environments/{BRAIN}/nodes/loud/log")
            for word in ("first", "second"):
                await rce("topic", "pub", "--once", f"{BRAIN}/loud", text, f"{{data: {word}}}", env=env)
                await log.expect_line(f"^{word}$")
            assert await asyncio.to_thread(_lines, stream, 3) == ["listening", "first", "second"]
            await asyncio.to_thread(stream.close)
            assert await log.interrupt() == 130
        assert f"{USER}/@console_" in await events.expect_line("robot.came")
        await rce("topic", "pub", "--once", f"{BRAIN}/loud", text, "{data: die}", env=env)
        await events.expect_line(f"node.died +{USER}/{BRAIN}/loud  ended with status 3")


def _follow(url: str) -> http.client.HTTPResponse:
    request = urllib.request.Request(f"{url}?follow=true")
    request.add_header("Authorization", f"Basic {base64.b64encode(f'{USER}:{USER}'.encode()).decode()}")
    stream: http.client.HTTPResponse = urllib.request.urlopen(request, timeout=120)
    return stream


def _lines(stream: http.client.HTTPResponse, count: int) -> list[str]:
    """Return the first lines of a log; those that are written at about the same time may come in one event."""
    lines: list[str] = []
    while len(lines) < count:
        data = next(line for line in stream if line.startswith(b"data:"))
        lines += json.loads(data[5:])["lines"]
    return lines


async def test_roles_limit_the_use_of_topics(env: dict[str, str], platform: RealPlatform, tmp_path: Path) -> None:
    """An administrator uses a user's environment; a viewer only reads."""
    admin = user_environ(tmp_path, platform.url, "admin")
    say, heard, text = f"{BRAIN}/say", f"{BRAIN}/heard", "std_msgs/String"
    key = (await rce("key", "create", "--role", "viewer", env=env)).split()[-1]
    viewer = user_environ(tmp_path) | {"RCE_URL": platform.url, "RCE_KEY": key}
    async with (
        running("topic", "echo", heard, text, env=viewer) as seen,
        running("topic", "echo", "--of", USER, heard, text, env=admin) as watched,
        running("topic", "pub", "--of", USER, "-r", "5", say, text, "{data: here}", env=admin),
    ):
        await seen.expect_line("data: here")
        await watched.expect_line("data: here")
        robots = await rce("robot", "list", "--json", env=env)
        assert {each["guest"] for each in json.loads(robots)} == {USER, "admin"}
        assert "in brain 42" in await rce("env", "shell", "--of", USER, BRAIN, "echo in brain $((6*7))", env=admin)
        for words in (("topic", "pub", "--once", say, text, "{data: no}"), ("env", "shell", BRAIN, "id")):
            assert "the role viewer may not" in await rce(*words, env=viewer, status=1)
        assert "there is no user admin" in await rce("topic", "echo", "--of", "admin", heard, env=viewer, status=1)
    await no_guest_interfaces(env)
    entries = await rce("audit", "--by", "admin", "--action", "data.read", env=env)
    assert f"{USER}/{heard}" in entries


async def test_interactive_console_completes_runs_and_interrupts_commands(env: dict[str, str]) -> None:
    await asyncio.to_thread(_use_console, env)


def _use_console(env: dict[str, str]) -> None:
    with on_terminal("console", env=env) as console:
        console.expect(">")
        console.type("env sho\t")
        console.expect("w")
        console.type(" con\t")
        console.expect("sole_brain")
        console.type("\r")
        console.expect("containerTag +console_brain")
        console.type("robot lst\r")
        console.expect("there is no command 'robot lst'")
        console.type("watch -n 0.2 node list console_brain\r")
        console.expect("rce_demo/echo")
        console.expect("rce_demo/echo")
        console.type("\x03")
        console.expect("[0-9]>")
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
async def test_bash_completes_commands_options_and_names(env: dict[str, str], words: str, expected: str) -> None:
    script = BASH.format(rce=RCE, words=words)
    done = await asyncio.to_thread(
        subprocess.run, ["bash", "-c", script], env=env, capture_output=True, text=True, timeout=120, check=True
    )
    assert done.stdout.split() == [expected], done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
async def test_completion_script_has_no_syntax_errors(env: dict[str, str], tmp_path: Path, shell: str) -> None:
    if shutil.which(shell) is None:
        pytest.skip(f"no {shell} here")
    script = tmp_path / "script"
    script.write_text(await rce("completion", shell, env=env))
    done = await asyncio.to_thread(subprocess.run, [shell, "-n", str(script)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
