# ruff: noqa: E402  (Docker is imported only where it is there)
"""The options of an environment under the engine `docker`, with a real daemon: asked for, given, and held to."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from engine_contract import Endings, spec

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from docker_world import DockerWorld
from engine_contract import with_options

from containers import docker_disks
from containers.docker_options import reference
from rce import __version__
from rce.errors import NoCapacity, StartFailed
from rce.messages import Rates
from rce.slots import MB

needs_disks = pytest.mark.skipif(os.geteuid() != 0, reason="disks of a fixed size need root: run the tests as root")


@pytest.fixture
def world(docker_world: DockerWorld) -> DockerWorld:
    return docker_world


def devices(world: DockerWorld) -> list[str]:
    """The loop devices of this test's disks."""
    files = (path.read_text().strip() for path in docker_disks.BLOCK.glob("loop*/loop/backing_file"))
    return [file for file in files if file.startswith(str(world.directory))]


async def filled(world: DockerWorld, endings: Endings, *behaviour: str, **options: object) -> tuple[int, float]:
    """The megabytes that an environment could write to its home, and the seconds that it took."""
    engine = world.engine(endings, "fill", *behaviour)
    await engine.open()
    await engine.start(with_options(**options))
    ended = await endings.next()
    await engine.close()
    assert world.there() == set()
    assert devices(world) == []
    match = re.search(r"(\d+) MB in ([\d.]+) s", "\n".join(ended.lines))
    assert match, ended
    return int(match[1]), float(match[2])


@needs_disks
async def test_a_disk_has_its_size_and_no_more(world: DockerWorld, endings: Endings) -> None:
    """It is no memory either: the environment has far less of that."""
    megabytes, _ = await filled(world, endings, disk=100 * MB, memory=40 * MB)
    assert 85 <= megabytes <= 100


async def test_without_a_disk_the_home_is_in_memory(world: DockerWorld, endings: Endings) -> None:
    megabytes, _ = await filled(world, endings)
    assert megabytes == 256


@needs_disks
async def test_the_rate_of_writing(world: DockerWorld, endings: Endings) -> None:
    megabytes, seconds = await filled(world, endings, "6", disk=20 * MB, io=Rates(write=4 * MB))
    assert megabytes == 6
    assert seconds > 0.9  # the first of it may pass at once


async def test_rates_of_reading_hold_for_the_image_too(world: DockerWorld, endings: Endings) -> None:
    engine = world.engine(endings)
    await engine.open()
    await engine.start(with_options(io=Rates(read=5 * MB, write=3 * MB), pids=77))
    host = world.inspect("ann/map")["HostConfig"]
    assert host["PidsLimit"] == 77
    ground = docker_disks.device_below(Path(world.api.info()["DockerRootDir"]))
    assert host["BlkioDeviceReadBps"] == ([{"Path": ground, "Rate": 5 * MB}] if ground else None)
    await engine.keep([])
    await engine.close()


@needs_disks
async def test_a_disk_outlives_the_task_set_and_goes_with_its_environment(world: DockerWorld, endings: Endings) -> None:
    first = world.engine(endings)
    await first.open()
    await first.start(with_options(disk=20 * MB))
    assert len(devices(world)) == 1
    await first.close()
    second = world.engine(endings)
    await second.open()
    assert list(second.running()) == ["ann/map"]
    assert len(devices(world)) == 1
    await second.stop("ann/map")
    assert devices(world) == []
    assert not list(world.directory.rglob("*.disk"))
    await second.close()


@needs_disks
async def test_the_disk_of_a_start_that_was_killed_is_removed(world: DockerWorld, endings: Endings) -> None:
    """The task set had made it, and no container yet."""
    place = world.directory / "environments" / "ann" / "map"
    place.mkdir(parents=True)
    docker_disks.make(place / f"{spec().run}.disk", 20 * MB, 10000)
    assert len(devices(world)) == 1
    engine = world.engine(endings)
    await engine.open()
    assert devices(world) == []
    assert world.there() == set()
    await engine.close()


async def test_gpus_are_asked_of_docker(world: DockerWorld, endings: Endings) -> None:
    """There is none here, and Docker says so: the request has reached it."""
    engine = world.engine(endings, gpus=2)
    await engine.open()
    with pytest.raises(StartFailed, match=r"gpu"):
        await engine.start(with_options(gpus=2))
    assert world.there() == set()
    with pytest.raises(NoCapacity, match="3 GPUs; 2 of this machine's 2"):
        await engine.start(with_options(gpus=3))
    await engine.close()


async def test_an_image_of_another_version(world: DockerWorld, endings: Endings) -> None:
    for label, fault in (("LABEL rce.version=0.0.1", "was made for RCE 0.0.1"), ("LABEL x=y", "has no label")):
        world.api.import_image_from_data(b"\0" * 1024, repository="rce-test/other", tag="1", changes=[label])
        engine = world.engine(endings)
        await engine.open()
        with pytest.raises(StartFailed, match=f"image rce-test/other:1 {fault}.*{__version__}"):
            await engine.start(with_options(image="rce-test/other:1"))
        assert world.there() == set()
        await engine.close()
        world.api.remove_image("rce-test/other:1")


def test_an_image_without_a_tag_is_that_of_this_version() -> None:
    assert reference("rce/base") == f"rce/base:{__version__}"
    assert reference("registry:5000/mine") == f"registry:5000/mine:{__version__}"
    assert reference("rce/base:7") == "rce/base:7"
    assert reference("mine@sha256:0") == "mine@sha256:0"
