"""What a hostile user tries from within an environment: each attempt fails, and the others do not notice it.

The programs are run by Docker in the environment's container: as its user, in its name spaces, under its limits, which
is all that a node has.
"""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hostile_programs as programs
import pytest
from real_platform import USER, RealPlatform
from test_kills import next_event

pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from rce.client import Environment, Robot
from rce.messages import LimitEvent

MB = 1024 * 1024
STRING = "std_msgs/String"
DISK = 50 * MB if os.geteuid() == 0 else 0


@dataclass
class Siege:
    """A hostile environment, and one beside it that must not notice."""

    platform: RealPlatform
    api: Any
    robot: Robot
    hostile: str  # the container
    victim: Environment
    say: Any
    heard: Any

    async def attack(self, program: str, *arguments: str) -> dict[str, Any]:
        """Run it to its end, while the victim works; what it said it achieved, and its exit status."""
        call = self.api.exec_create(self.hostile, ["python3", "-P", "-c", programs.HEAD + program, *arguments])
        running = asyncio.create_task(asyncio.to_thread(self.api.exec_start, call["Id"]))
        await self.works()
        output = (await running).decode(errors="replace")
        await self.works()
        said = next((line for line in output.splitlines() if line.startswith("{")), "{}")
        return {**json.loads(said), "status": self.api.exec_inspect(call["Id"])["ExitCode"], "output": output}

    async def works(self) -> None:
        """From the robot to a node of the victim and back; and the platform still does what it is asked."""
        async with asyncio.timeout(20):
            await self.say.publish({"data": "still"})
            assert await anext(aiter(self.heard)) == {"data": "still"}
            await self.victim.set_parameter("round", 1)


@pytest.fixture(scope="module")
async def siege(contained: RealPlatform, images: Any) -> AsyncIterator[Siege]:
    async with (
        contained.robot("hostile") as robot,
        robot.environment("victim", cpu=1) as victim,
        robot.environment("siege", memory=700 * MB, cpu=0.5, pids=100, disk=DISK),
    ):
        await victim.add_node("echo", "rce_demo", "echo.py")
        heard = await victim.subscriber("/heard", STRING)
        say = await victim.publisher("/say", STRING)
        label = f"rce.environment={USER}/siege"
        (hostile,) = [each["Id"] for each in images.containers(filters={"label": label})]
        yield Siege(contained, images, robot, hostile, victim, say, heard)


async def test_a_fork_bomb(siege: Siege) -> None:
    bomb = asyncio.create_task(siege.attack(programs.FORK_BOMB))
    most = 0
    while not bomb.done():
        top = await asyncio.to_thread(siege.api.top, siege.hostile)
        most = max(most, len(top["Processes"]))
        await asyncio.sleep(0.2)
    await bomb
    while len((await asyncio.to_thread(siege.api.top, siege.hostile))["Processes"]) > 10:  # noqa: ASYNC110
        await asyncio.sleep(0.2)  # its last children may outlive it by a little
    assert 50 < most <= 100


async def test_using_up_the_memory(siege: Siege) -> None:
    events = siege.robot.events()
    found = await siege.attack(programs.MEMORY)
    assert found["status"] == 137  # killed
    assert "siege" in (await next_event(events, LimitEvent)).reason


async def test_using_up_the_memory_by_files(siege: Siege) -> None:
    """What is in `/dev/shm` and `/tmp` counts as the environment's: it is that environment that suffers."""
    events = siege.robot.events()
    async with siege.robot.environment("flooded", memory=200 * MB):
        label = f"rce.environment={USER}/flooded"
        (container,) = [each["Id"] for each in siege.api.containers(filters={"label": label})]
        call = siege.api.exec_create(container, ["python3", "-c", programs.HEAD + programs.FILES_IN_MEMORY])
        running = asyncio.create_task(asyncio.to_thread(siege.api.exec_start, call["Id"]))
        assert "memory" in (await next_event(events, LimitEvent, "flooded")).reason
        await siege.works()
        await running


async def test_filling_the_disk(siege: Siege) -> None:
    found = await siege.attack(programs.FILL, "/home/rce", "/tmp")
    home = DISK // MB if DISK else 256
    assert found["/home/rce"][0] <= home
    assert found["/tmp"][0] <= 128
    assert found["/home/rce"][1] == found["/tmp"][1] == "No space left on device"


async def test_opening_files(siege: Siege) -> None:
    found = await siege.attack(programs.OPEN_FILES)
    assert found["reason"] == "Too many open files"
    assert found["files"] <= 4096


async def test_flooding_the_log(siege: Siege) -> None:
    """Forty megabytes, of which Docker keeps four."""
    found = await siege.attack(programs.LOG_FLOOD)
    assert found["done"]
    log = Path(siege.api.inspect_container(siege.hostile)["LogPath"])
    if os.geteuid() == 0:
        assert sum(path.stat().st_size for path in log.parent.glob(f"{log.name}*")) < 4.5 * MB
    assert len(siege.api.logs(siege.hostile)) < 4.5 * MB


async def test_looking_at_the_host(siege: Siege) -> None:
    found = await siege.attack(programs.LOOK_AROUND)
    sockets = siege.platform.directory / "data" / "container" / "sockets" / USER
    disks = {"/home/rce"} if DISK else set()
    assert set(found["writable"]) == {str(sockets)} | disks
    assert "/run/rce" in found["read_only"]
    assert found["processes"] == []
    assert found["sockets"] == []
    assert found["kernel"] == 0
    assert found["namespace"] == "its own"
    refused = ("shadow", "memory", "device", "settings", "trigger", "groups", "root")
    reasons = {"Permission denied", "Operation not permitted", "No such file or directory", "Read-only file system"}
    assert {name: found[name] for name in refused if found[name] not in reasons} == {}


async def test_joining_the_master_as_somebody_else(siege: Siege) -> None:
    """Nor as itself: its token was used."""
    found = await siege.attack(programs.IMPERSONATE, f"{USER}/victim")
    joins = {key: value for key, value in found.items() if key.startswith(("environment", "container", "robot", "mas"))}
    assert len(joins) == 8, found["output"]
    assert set(joins.values()) == {"unauthorized"}


async def test_reaching_what_the_platform_listens_at(siege: Siege) -> None:
    """There is no network, and the sockets of the user's other environments want the key of a link."""
    entry = siege.platform.url.removeprefix("http://").rstrip("/")
    ports = [f"127.0.0.1:{port}" for port in listening(siege.platform)]
    assert ports
    found = await siege.attack(programs.REACH, entry, *ports, "169.254.169.254:80", "192.168.1.1:53")
    for place in (entry, *ports, "169.254.169.254:80", "192.168.1.1:53"):
        assert found[place] in ("Connection refused", "Network is unreachable"), place
    assert found["users"] == [USER]
    assert found["other"].startswith(("closed after", "Connection reset"))


def listening(platform: RealPlatform) -> set[int]:
    """The TCP ports of the platform's processes."""
    inodes = set()
    for pid in platform.processes():
        for descriptor in Path(f"/proc/{pid}/fd").glob("*"):
            try:
                inodes.add(os.readlink(descriptor).removeprefix("socket:[").removesuffix("]"))
            except OSError:
                continue
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return {int(line[1].split(":")[1], 16) for line in lines if line[3] == "0A" and line[9] in inodes}
