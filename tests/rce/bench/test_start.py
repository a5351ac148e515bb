"""Starts of environments."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import cast

import pytest

from rce.bench import start
from rce.client import Robot
from rce.errors import StartFailed

DOCKER = """\
#!/bin/sh
echo "$@" >> "$DOCKER_LOG"
if [ "$FAILS" = "$1" ]; then echo "no such image" >&2; exit 125; fi
"""


class FakeRobot:
    """Robot that records its environments."""

    def __init__(self) -> None:
        self.created: list[str] = []
        self.destroyed: list[str] = []

    async def create_environment(self, tag: str, restart: str) -> None:
        assert restart == "no"
        self.created.append(tag)

    async def destroy_environment(self, tag: str) -> None:
        self.destroyed.append(tag)

    async def service(self, name: str) -> FakeService:
        self.created.append(name)
        return FakeService(name)


class FakeService:
    """Service that answers at once."""

    def __init__(self, tag: str) -> None:
        self.tag = tag

    def publisher(self, name: str) -> FakeService:
        assert name in start.SERVICE.takes
        return self

    def subscriber(self, name: str) -> FakeService:
        assert name in start.SERVICE.gives
        return self

    async def publish(self, message: object) -> None: ...

    async def get(self) -> None: ...

    async def leave(self) -> None: ...


@pytest.fixture
def docker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Log of the commands of a stand-in for Docker."""
    program = tmp_path / "docker"
    program.write_text(DOCKER)
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setenv("DOCKER_LOG", str(tmp_path / "log"))
    return tmp_path / "log"


async def test_first_start_of_each_engine_is_discarded() -> None:
    one, other = FakeRobot(), FakeRobot()
    robots = {"process": cast(Robot, one), "swarm": cast(Robot, other)}
    taken = await start.measure(robots, "image", 2, services=False, pause=0)
    assert {name: len(seconds) for name, seconds in taken.items()} == {"process": 2, "swarm": 2}
    assert len(one.created) == len(set(one.created)) == 3
    assert one.destroyed == one.created


async def test_services_are_measured_to_their_first_answer() -> None:
    robot = FakeRobot()
    taken = await start.measure({"process": cast(Robot, robot)}, "image", 1, pause=0)
    assert {name: len(seconds) for name, seconds in taken.items()} == {"process": 1, "service, process": 1}
    assert robot.created.count(start.SERVICE.name) == 2
    assert robot.destroyed == robot.created


async def test_docker_is_compared_with_a_bare_container(docker: Path) -> None:
    taken = await start.measure({"docker": cast(Robot, FakeRobot())}, "rce/mapping:1", 1, services=False, pause=0)
    assert [len(taken[name]) for name in ("docker", start.BARE)] == [1, 1]
    log = await asyncio.to_thread(docker.read_text)
    run, remove, *_ = [line.split() for line in log.splitlines()]
    assert run[:2] == ["run", "--name"]
    assert run[3:] == ["--network", "none", "rce/mapping:1", *" ".join(start.COMMAND).split()]
    assert remove == ["rm", run[2]]


async def test_container_that_fails_ends_the_benchmark(docker: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAILS", "run")
    with pytest.raises(StartFailed, match="docker run: no such image"):
        await start.measure({"docker": cast(Robot, FakeRobot())}, "none", 1, services=False, pause=0)


async def test_without_docker_there_is_nothing_to_compare_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert list(await start.measure({"docker": cast(Robot, FakeRobot())}, "image", 1, services=False, pause=0)) == [
        "docker"
    ]


def test_table_of_starts_has_ratios() -> None:
    text = start.as_text({"process": [1.0, 3.0, 2.0], start.BARE: [1.0, 1.0]})
    assert ["process", "2.000", "s", "1.000", "s", "3.000", "s", "2.00"] in [line.split() for line in text.splitlines()]


def test_table_without_a_bare_container_has_no_ratios() -> None:
    assert start.as_text({"process": [1.0]}).splitlines()[-1].split() == ["process", *["1.000", "s"] * 3]


def test_data_has_all_samples() -> None:
    assert json.loads(json.dumps(start.as_data({"process": [1.0, 2.0]})))["seconds"] == {"process": [1.0, 2.0]}
