"""Many environments at the same time, and a task set that is killed while they start, run or stop.

Under `docker` they run in a network namespace (tests/support/island.py), each with a disk, in one network group.
"""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, closing, suppress
from pathlib import Path
from typing import Any

import pytest

from rce.errors import NotFound, RceError
from tests.support.e2e.real_platform import USER, RealPlatform, containers, until
from tests.support.e2e.traffic import Echo

MB = 1024 * 1024
MANY, ROBOTS = 20, 5
TASK_SET = r"-m containers( |$)"


class Site:
    """A platform with one engine, and queries of what environments leave behind."""

    def __init__(self, engine: str, platform: RealPlatform, api: Any) -> None:
        self.engine = engine
        self.platform = platform
        self.options: dict[str, Any] = {"group": "crew"} | ({"disk": 8 * MB} if engine == "docker" else {})
        self._api = api

    def lives(self) -> dict[str, Any]:
        """Return the container or process of each running environment, by name."""
        if self.engine == "docker":
            return {each["Labels"]["rce.environment"]: each["Id"] for each in containers(self._api, self.platform)}
        tags = [path.name for path in self._environments.glob(f"{USER}/*")]
        return {f"{USER}/{tag}": pid for tag in tags if (pid := self.platform.environment_pid(tag))}

    def left(self) -> list[str]:
        """Return all that exists of environments: containers, networks, processes, directories, sockets, disks."""
        container = self.platform.directory / "data" / "container"
        places = [*self._environments.glob("*"), *container.glob("sockets/*")]
        found = [*self.lives(), *(str(path) for path in places)]
        found += [words for words in self.platform.processes().values() if "endpoints.environment" in words]
        found += self.networks()
        return found + [disk for disk in disks() if disk.startswith(str(container))]

    def networks(self) -> list[str]:
        """Return networks of groups, and rules of the packet filter for them."""
        if self.engine != "docker":
            return []
        label = f"rce.directory={self.platform.directory / 'data' / 'container'}"
        rules = subprocess.check_output(["iptables", "-w", "-S"], text=True).splitlines()
        named = [each["Name"] for each in self._api.networks(filters={"label": label})]
        return named + [rule for rule in rules if "--comment rce-" in rule]

    async def kill_task_set(self) -> None:
        """Kill the task set and wait for the next one."""
        killed = self.platform.pid(TASK_SET)
        self.platform.kill(killed)
        await until(lambda: self.platform.pid(TASK_SET, but=killed), what="a new task set")

    @property
    def _environments(self) -> Path:
        return self.platform.directory / "data" / "container" / "environments"


def disks() -> list[str]:
    """Return the files behind loop devices."""
    found = []
    for path in Path("/sys/block").glob("loop*/loop/backing_file"):
        with suppress(OSError):  # detached meanwhile
            found.append(path.read_text().strip())
    return found


@pytest.fixture(scope="module", params=["process", "docker"])
async def site(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Site]:
    arguments = ["--engine", request.param, "--size", str(MANY)]
    async with AsyncExitStack() as stack:
        api = None
        if request.param == "docker":
            import docker

            island = request.getfixturevalue("island")
            stack.enter_context(island.inside())
            api = stack.enter_context(closing(docker.APIClient(island.host, version="auto", timeout=60)))
        platform = RealPlatform(tmp_path_factory.mktemp(request.param), *arguments)
        yield Site(request.param, await stack.enter_async_context(platform), api)


async def test_many_environments_at_the_same_time(site: Site) -> None:
    """Five robots create 20 environments. All run when they are acknowledged, and nothing is left afterwards."""
    async with AsyncExitStack() as stack:
        robots = [await stack.enter_async_context(site.platform.robot(f"r{number}", 240)) for number in range(ROBOTS)]
        tags = [(robots[number % ROBOTS], f"many{number}") for number in range(MANY)]
        await asyncio.gather(*(robot.create_environment(tag) for robot, tag in tags))
        assert set(site.lives()) == {f"{USER}/{tag}" for _, tag in tags}
        await asyncio.gather(*(robot.destroy_environment(tag) for robot, tag in tags))
    assert site.left() == []


async def test_environments_of_a_killed_task_set_are_adopted(site: Site) -> None:
    async with site.platform.robot("keeper", 120) as robot, AsyncExitStack() as stack:
        made = [stack.enter_async_context(robot.environment(f"kept{number}", **site.options)) for number in range(5)]
        environments = await asyncio.gather(*made)
        echoes = [await Echo.of(environment) for environment in environments]
        await asyncio.gather(*(echo.answers() for echo in echoes))
        before = site.lives()
        assert len(before) == 5
        killed = site.platform.pid(TASK_SET)
        site.platform.kill(killed)
        await asyncio.gather(*(echo.once() for echo in echoes))
        await until(lambda: site.platform.pid(TASK_SET, but=killed), what="a new task set")
        await robot.create_environment("fresh")  # it works again
        await robot.destroy_environment("fresh")
        assert site.lives() == before
        await asyncio.gather(*(echo.once() for echo in echoes))
    assert site.left() == []


@pytest.mark.parametrize("moment", ["at once", "when something exists", "when it runs"])
async def test_task_set_killed_during_a_start_leaves_nothing(site: Site, moment: str) -> None:
    reached: dict[str, Callable[[], object]] = {
        "at once": lambda: True,
        "when something exists": site.networks if site.engine == "docker" else site.left,
        "when it runs": site.lives,
    }
    async with site.platform.robot("starter", 120) as robot:
        start = asyncio.create_task(robot.create_environment("begun", **site.options))
        await until(reached[moment], what=moment)
        await site.kill_task_set()
        with suppress(RceError):  # it may be reported as lost with its task set
            await start
        with suppress(NotFound):
            await robot.destroy_environment("begun")
        await until(lambda: not site.left(), what=f"nothing left: {site.left()}")
        async with robot.environment("next"):
            assert list(site.lives()) == [f"{USER}/next"]
    assert site.left() == []


@pytest.mark.parametrize("moment", ["at once", "when one is removed"])
async def test_task_set_killed_during_a_stop_leaves_nothing(site: Site, moment: str) -> None:
    async with site.platform.robot("stopper", 120) as robot:
        tags = ["ending0", "ending1", "ending2"]
        await asyncio.gather(*(robot.create_environment(tag, **site.options) for tag in tags))
        stops = [asyncio.create_task(robot.destroy_environment(tag)) for tag in tags]
        if moment == "when one is removed":
            await until(lambda: len(site.lives()) < len(tags), what=moment)
        await site.kill_task_set()
        await asyncio.gather(*stops, return_exceptions=True)
        await until(lambda: not site.left(), what="nothing left")
    assert site.left() == []
