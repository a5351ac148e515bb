"""Full disks, one process after the other: refusals say so, data flows on, and everything works again by itself."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install '.[ros]'")

from rce.bench.chaos.flows import NODE, PACKAGE, Flow, through_node
from rce.bench.chaos.platform import MAPS, TASK_SET, USER, Platform, running
from rce.bench.chaos.processes import of_environments
from rce.bench.chaos.workload import recording
from rce.client import Robot
from rce.errors import AlreadyExists, RceError, Unavailable
from tests.support.e2e.real_platform import until
from tests.support.privileges import skip_without_mounts

FULL = r"disk full"
TIMEOUT = 60.0  # seconds

pytestmark = [pytest.mark.e2e, pytest.mark.ros]


@pytest.fixture(scope="module")
async def platform(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Platform]:
    skip_without_mounts()
    async with running(tmp_path_factory.mktemp("disks")) as platform:
        yield platform


@pytest.fixture(scope="module")
async def robot(platform: Platform) -> AsyncIterator[Robot]:
    async with platform.robot("robot") as robot:
        yield robot


@pytest.fixture(scope="module")
async def flow(robot: Robot) -> AsyncIterator[Flow]:
    """Numbered messages through an environment, which no full disk may disturb."""
    await robot.create_environment("home")
    flow = await through_node(robot, robot.environment("home"))
    yield flow
    await flow.end()
    assert flow.count().lost == 0, f"{flow.lost()} of {flow.count().sent}"


async def refusal(command: Callable[[int], Awaitable[object]]) -> RceError:
    """Repeat a command with a growing number until it is refused; what is buffered may take it a few times."""
    async with asyncio.timeout(TIMEOUT):
        number = 0
        while True:
            number += 1
            try:
                await command(number)
            except RceError as error:
                return error


async def succeed(command: Callable[[], Awaitable[object]]) -> None:
    """Repeat a command until it succeeds."""
    async with asyncio.timeout(TIMEOUT):
        while True:
            try:
                await command()
            except AlreadyExists:
                return
            except RceError:
                await asyncio.sleep(0.2)
            else:
                return


async def join(platform: Platform, name: str) -> None:
    """Let a robot join and leave."""
    async with platform.robot(name):
        pass


async def kill(platform: Platform, name: str) -> None:
    """Kill a process of the platform and wait until another one runs in its place."""
    process = platform.processes[name]
    before = process.pid
    os.kill(before, signal.SIGKILL)
    await until(lambda: process.pid != before, TIMEOUT)


async def test_master_refuses_what_it_cannot_store(platform: Platform, robot: Robot, flow: Flow) -> None:
    disk = platform.disks["master"]
    disk.fill()
    try:
        error = await refusal(lambda number: robot.set_parameter("home", f"p{number}", "x" * 1000))
        assert FULL in str(error)
        error = await refusal(lambda number: robot.set_parameter("home", "refused", number))
        assert FULL in str(error)
        error = await refusal(lambda _: join(platform, "late"))
        assert FULL in str(error)
        assert isinstance(error, Unavailable)
    finally:
        await disk.free()
    await robot.set_parameter("home", "refused", 1)
    await join(platform, "late")


async def test_master_that_is_restarted_on_a_full_disk_comes_back(platform: Platform, robot: Robot, flow: Flow) -> None:
    await robot.set_parameter("home", "kept", 1)
    disk = platform.disks["master"]
    disk.fill()
    try:
        await kill(platform, "master")
    finally:
        await disk.free()
    await succeed(lambda: robot.set_parameter("home", "again", 1))
    await robot.delete_parameter("home", "kept")


@pytest.mark.parametrize("name", ["robot-1", "robot-2"])
async def test_robot_endpoint_that_is_restarted_on_a_full_disk_serves_robots(
    platform: Platform, robot: Robot, flow: Flow, name: str
) -> None:
    disk = platform.disks[name]
    began = time.monotonic()
    disk.fill()
    try:
        await kill(platform, name)
        await flow.wait_for_message(time.monotonic(), TIMEOUT)
        await succeed(lambda: robot.set_parameter("home", "p", 1))
    finally:
        await disk.free()
    flow.disturb(began, time.monotonic())  # it may have had messages in its memory
    async with platform.robot("one"), platform.robot("two"):
        pass


async def test_task_set_refuses_environments_and_nodes(platform: Platform, robot: Robot, flow: Flow) -> None:
    disk = platform.disks[TASK_SET]
    disk.fill()
    try:
        with pytest.raises(RceError, match=FULL):
            await robot.create_environment("refused")
        with pytest.raises(RceError, match=FULL):
            await robot.add_node("home", "refused", PACKAGE, NODE, namespace="refused")
    finally:
        await disk.free()
    await robot.create_environment("refused")
    await robot.add_node("home", "refused", PACKAGE, NODE, namespace="refused")
    await robot.remove_node("home", "refused")
    await robot.destroy_environment("refused")


async def test_task_set_that_is_restarted_on_a_full_disk_keeps_its_environments(
    platform: Platform, robot: Robot, flow: Flow
) -> None:
    before = of_environments(platform.directory / TASK_SET, USER)
    disk = platform.disks[TASK_SET]
    disk.fill()
    try:
        await kill(platform, TASK_SET)
    finally:
        await disk.free()
    await succeed(lambda: robot.create_environment("after"))
    await robot.destroy_environment("after")
    await until(lambda: set(of_environments(platform.directory / TASK_SET, USER)) == set(before), TIMEOUT)


async def test_map_service_refuses_uploads(platform: Platform, tmp_path: Path) -> None:
    maps, disk = platform.maps(patience=0.5), platform.disks[MAPS]
    file = tmp_path / "a.log"
    await asyncio.to_thread(file.write_text, recording(100))
    disk.fill()
    try:
        with pytest.raises(RceError, match=FULL):
            await asyncio.to_thread(maps.upload, file)
        await kill(platform, MAPS)
    finally:
        await disk.free()
    await succeed(lambda: asyncio.to_thread(maps.upload, file))
    (upload,) = await asyncio.to_thread(maps.uploads)
    assert upload.offset == upload.length


async def test_environment_that_died_on_a_full_disk_comes_back(platform: Platform, robot: Robot) -> None:
    await robot.create_environment("fragile")
    (pid,) = (
        each.pid for each in of_environments(platform.directory / TASK_SET, USER) if each.environment == "fragile"
    )
    disk = platform.disks[TASK_SET]
    disk.fill()
    try:
        os.kill(pid, signal.SIGKILL)
        await until(lambda: "fragile did not start" in platform.log.read_text(), TIMEOUT)
    finally:
        await disk.free()
    await succeed(lambda: robot.add_node("fragile", NODE, PACKAGE, NODE))
    await robot.destroy_environment("fragile")
