"""Launch files on a real platform: their nodes one by one, together, and in a new life of the environment."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from rce.client import Environment
from rce.errors import InvalidRequest, NotFound, TimedOut
from rce.protocol.messages import NodeEvent
from tests.support.e2e.consoles import rce, user_environ
from tests.support.e2e.real_platform import RealPlatform, until

WAIT = 60.0  # seconds
FILE = "echo.launch.xml"
TAGS = ["up", "up.first.echo", "up.second.echo"]


async def nodes(env: Mapping[str, str], tag: str, *options: str) -> dict[str, dict[str, Any]]:
    """Return the nodes of an environment by tag, as the console lists them."""
    listed = json.loads(await rce("node", "list", tag, "--json", *options, env=env))
    return {each["nodeTag"]: each for each in listed}


async def echo(environment: Environment, namespace: str) -> None:
    """Send a message to an echo of the launch and wait for it."""
    speak = await environment.publisher(f"/{namespace}/say", "std_msgs/String")
    listen = await environment.subscriber(f"/{namespace}/heard", "std_msgs/String")
    async with asyncio.timeout(WAIT):
        while True:
            await speak.publish({"data": namespace})
            try:
                assert await listen.get(1.0) == {"data": namespace}
            except TimedOut:
                continue
            break
    await speak.close()
    await listen.close()


def process_of(platform: RealPlatform, enclave: str) -> int:
    return platform.pid(f"--enclave /{enclave}")


async def test_launch_is_one_thing_with_single_nodes(platform: RealPlatform, tmp_path: Path) -> None:
    env = user_environ(tmp_path, platform.url)
    async with platform.robot("launcher") as robot, robot.environment("launched") as launched:
        events = robot.events()
        await launched.add_node("up", "rce_demo", launch=FILE, args="robots:=2")
        shown = await nodes(env, "launched")
        assert {tag: (each["state"], each["partOf"]) for tag, each in shown.items()} == {
            "up": ("running", ""),
            "up.first.echo": ("running", "up"),
            "up.second.echo": ("running", "up"),
        }
        await echo(launched, "first")
        await echo(launched, "second")
        assert "up.first.echo started: rce_demo echo" in await rce("node", "logs", "launched", "up", env=env)
        refused = await rce("node", "stop", "launched", "up.first.echo", env=env, status=1)
        assert "is part of launch up, which ends as a whole" in refused

        os.kill(process_of(platform, "up_first_echo"), signal.SIGKILL)
        while not isinstance(event := await events.get(WAIT), NodeEvent):
            pass
        assert (event.nodeTag, event.status) == ("up.first.echo", -9)
        shown = await nodes(env, "launched", "--all")
        assert [(tag, shown[tag]["state"]) for tag in TAGS] == [
            *((TAGS[0], "running"), (TAGS[1], "ended"), (TAGS[2], "running"))
        ]
        await echo(launched, "second")

        await launched.remove_node("up")
        assert await nodes(env, "launched") == {}
        assert not [each for each in platform.processes().values() if "up_second_echo" in each]


async def test_launch_file_is_carried_out_again_in_a_new_life(fragile: RealPlatform, tmp_path: Path) -> None:
    env = user_environ(tmp_path, fragile.url)
    async with fragile.robot("r1") as robot, robot.environment("home") as home:
        await rce("node", "launch", "home", "up", "rce_demo", FILE, "robots:=1", env=env)
        await echo(home, "first")
        before = fragile.environment_pid("home")
        fragile.kill(before)
        await until(lambda: fragile.environment_pid("home", before))
        await echo(home, "first")
        assert set(await nodes(env, "home")) == {"up", "up.first.echo"}

        fragile.kill(fragile.pid("-m master "))
        await home.add_node("more", "rce_demo", launch=FILE, args="robots:=1")
        assert set(await nodes(env, "home")) == {"up", "up.first.echo", "more", "more.first.echo"}


async def test_wrong_launch_is_refused_with_the_reason(platform: RealPlatform) -> None:
    async with platform.robot("refused") as robot, robot.environment("none") as none:
        with pytest.raises(NotFound, match=f"no launch file echo.launch.yaml: did you mean {FILE}"):
            await none.add_node("up", "rce_demo", launch="echo.launch.yaml")
        with pytest.raises(InvalidRequest, match="the launch file has no argument robot; it has robots"):
            await none.add_node("up", "rce_demo", launch=FILE, args="robot:=2")
