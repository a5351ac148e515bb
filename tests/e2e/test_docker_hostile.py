"""Attacks of a hostile user from within an environment: each fails without an effect on other environments.

Docker runs the programs in the environment's container, with the same user, namespaces and limits as a ROS node there.
"""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from containers.endpoint import OPEN_FILES
from tests.support.e2e import hostile_programs as programs
from tests.support.e2e.real_platform import USER, RealPlatform, containers
from tests.support.e2e.traffic import Echo, next_event

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from rce.client import Environment, Robot
from rce.protocol.messages import LimitEvent

MB = 1024 * 1024
DISK = 50 * MB if os.geteuid() == 0 else 0


@dataclass
class Siege:
    """A hostile environment, and a second one that must not be affected."""

    platform: RealPlatform
    api: Any
    robot: Robot
    hostile: str  # the container
    victim: Environment
    echo: Echo

    async def attack(self, program: str, *arguments: str) -> dict[str, Any]:
        """Run a program while the victim works; return what it reports, its exit status and its output."""
        call = self.api.exec_create(self.hostile, ["python3", "-P", "-c", programs.HEAD + program, *arguments])
        running = asyncio.create_task(asyncio.to_thread(self.api.exec_start, call["Id"]))
        await self.works()
        output = (await running).decode(errors="replace")
        await self.works()
        report = next((line for line in output.splitlines() if line.startswith("{")), "{}")
        return {**json.loads(report), "status": self.api.exec_inspect(call["Id"])["ExitCode"], "output": output}

    async def works(self) -> None:
        """Check that messages pass from the robot to a node of the victim and back, and that the platform serves it."""
        await self.echo.once()
        await self.victim.set_parameter("round", 1)


@pytest.fixture(scope="module")
async def siege(contained: RealPlatform, images: Any) -> AsyncIterator[Siege]:
    async with (
        contained.robot("hostile") as robot,
        robot.environment("victim", cpu=1) as victim,
        robot.environment("siege", memory=700 * MB, cpu=0.5, pids=100, disk=DISK),
    ):
        echo = await Echo.of(victim)
        await echo.answers()
        (hostile,) = [each["Id"] for each in containers(images, contained, "siege")]
        yield Siege(contained, images, robot, hostile, victim, echo)


async def test_fork_bomb_is_limited(siege: Siege) -> None:
    bomb = asyncio.create_task(siege.attack(programs.FORK_BOMB))
    most = 0
    while not bomb.done():
        top = await asyncio.to_thread(siege.api.top, siege.hostile)
        most = max(most, len(top["Processes"]))
        await asyncio.sleep(0.2)
    await bomb
    while len((await asyncio.to_thread(siege.api.top, siege.hostile))["Processes"]) > 10:  # noqa: ASYNC110
        await asyncio.sleep(0.2)  # its last children end a little later
    assert 50 < most <= 100


async def test_process_beyond_the_memory_limit_is_killed(siege: Siege) -> None:
    events = siege.robot.events()
    found = await siege.attack(programs.MEMORY)
    assert found["status"] == 137  # killed
    assert "siege" in (await next_event(events, LimitEvent)).reason


async def test_files_in_memory_count_towards_the_limit(siege: Siege) -> None:
    """Files in `/dev/shm` and `/tmp` count towards the memory of their environment, so only that one is affected."""
    events = siege.robot.events()
    async with siege.robot.environment("flooded", memory=200 * MB):
        (container,) = [each["Id"] for each in containers(siege.api, siege.platform, "flooded")]
        call = siege.api.exec_create(container, ["python3", "-c", programs.HEAD + programs.FILES_IN_MEMORY])
        running = asyncio.create_task(asyncio.to_thread(siege.api.exec_start, call["Id"]))
        assert "memory" in (await next_event(events, LimitEvent, "flooded")).reason
        await siege.works()
        await running


async def test_writable_directories_are_limited(siege: Siege) -> None:
    found = await siege.attack(programs.FILL, "/home/rce", "/tmp")
    home = DISK // MB if DISK else 256
    assert found["/home/rce"][0] <= home
    assert found["/tmp"][0] <= 128
    assert found["/home/rce"][1] == found["/tmp"][1] == "No space left on device"


async def test_open_files_are_limited(siege: Siege) -> None:
    found = await siege.attack(programs.OPEN_FILES)
    assert found["reason"] == "Too many open files"
    assert found["files"] <= OPEN_FILES


async def test_log_is_bounded(siege: Siege) -> None:
    """The program writes 40 MB, of which Docker keeps 4 MB."""
    found = await siege.attack(programs.LOG_FLOOD)
    assert found["done"]
    log = Path(siege.api.inspect_container(siege.hostile)["LogPath"])
    if os.geteuid() == 0:
        assert sum(path.stat().st_size for path in log.parent.glob(f"{log.name}*")) < 4.5 * MB
    assert len(siege.api.logs(siege.hostile)) < 4.5 * MB


async def test_host_is_not_visible(siege: Siege) -> None:
    found = await siege.attack(programs.LOOK_AROUND)
    assert found["writable"] == (["/home/rce"] if DISK else [])
    assert "/run/rce" in found["read_only"]
    assert found["processes"] == []
    assert found["sockets"] == []
    assert found["kernel"] == 0
    assert found["namespace"] == "its own"
    refused = ("shadow", "memory", "device", "settings", "trigger", "groups", "root")
    reasons = {"Permission denied", "Operation not permitted", "No such file or directory", "Read-only file system"}
    assert {name: found[name] for name in refused if found[name] not in reasons} == {}


async def test_impersonation_is_unauthorized(siege: Siege) -> None:
    """Not even joining again as itself succeeds, because its token was used."""
    found = await siege.attack(programs.IMPERSONATE, f"{USER}/victim")
    joins = {key: value for key, value in found.items() if key.startswith(("environment", "container", "robot", "mas"))}
    assert len(joins) == 8, found["output"]
    assert set(joins.values()) == {"unauthorized"}


async def test_ports_of_the_platform_are_unreachable(siege: Siege) -> None:
    """The environment has no network, and the sockets of the user's other environments require the key of a link."""
    entry = siege.platform.url.removeprefix("http://").rstrip("/")
    ports = [f"127.0.0.1:{port}" for port in listening(siege.platform)]
    assert ports
    found = await siege.attack(programs.REACH, entry, *ports, "169.254.169.254:80", "192.168.1.1:53")
    for address in (entry, *ports, "169.254.169.254:80", "192.168.1.1:53"):
        assert found[address] in ("Connection refused", "Network is unreachable"), address
    assert found["users"] == [USER]
    assert found["other"].startswith(("closed after", "Connection reset"))


def listening(platform: RealPlatform) -> set[int]:
    """Return the TCP ports on which the platform's processes listen."""
    inodes = set()
    for pid in platform.processes():
        for descriptor in Path(f"/proc/{pid}/fd").glob("*"):
            try:
                inodes.add(os.readlink(descriptor).removeprefix("socket:[").removesuffix("]"))
            except OSError:
                continue
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return {int(line[1].split(":")[1], 16) for line in lines if line[3] == "0A" and line[9] in inodes}
