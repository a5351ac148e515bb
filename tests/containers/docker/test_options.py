# ruff: noqa: E402  (imports after importorskip)
"""Options of environments under the engine `docker` with a real daemon: granted and enforced."""

from __future__ import annotations

import os
import re
import secrets
from pathlib import Path

import pytest

from tests.support.containers.engine_contract import Endings, opened, spec

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from containers.docker import disks
from rce import __version__
from rce.errors import NoCapacity, StartFailed
from rce.protocol.messages import Rates
from rce.protocol.slots import MB
from tests.support.containers.docker_world import DockerWorld
from tests.support.containers.engine_contract import with_options

needs_disks = pytest.mark.skipif(os.geteuid() != 0, reason="disks of a fixed size need root: run the tests as root")


@pytest.fixture
def world(docker_world: DockerWorld) -> DockerWorld:
    return docker_world


def devices(world: DockerWorld) -> list[str]:
    """Return the files behind the loop devices of this test."""
    files = (path.read_text().strip() for path in disks.BLOCK.glob("loop*/loop/backing_file"))
    return [file for file in files if file.startswith(str(world.directory))]


async def filled(world: DockerWorld, endings: Endings, *behaviour: str, **options: object) -> tuple[int, float]:
    """Return the megabytes that an environment could write to its home directory, and the seconds that it took."""
    async with opened(world.engine(endings, "fill", *behaviour)) as engine:
        await engine.start(with_options(**options))
        ended = await endings.next()
    assert world.remains() == set()
    assert devices(world) == []
    match = re.search(r"(\d+) MB in ([\d.]+) s", "\n".join(ended.lines))
    assert match, ended
    return int(match[1]), float(match[2])


@needs_disks
async def test_disk_is_limited_to_its_size(world: DockerWorld, endings: Endings) -> None:
    """The disk is not in memory either, of which the environment has far less."""
    megabytes, _ = await filled(world, endings, disk=100 * MB, memory=40 * MB)
    assert 85 <= megabytes <= 100


async def test_home_is_in_memory_without_a_disk(world: DockerWorld, endings: Endings) -> None:
    megabytes, _ = await filled(world, endings)
    assert megabytes == 256


@needs_disks
async def test_write_rate_is_limited(world: DockerWorld, endings: Endings) -> None:
    megabytes, seconds = await filled(world, endings, "6", disk=20 * MB, io=Rates(write=4 * MB))
    assert megabytes == 6
    assert seconds > 0.9  # the first bytes may pass at once


async def test_read_rate_limit_includes_the_image(world: DockerWorld, endings: Endings) -> None:
    async with opened(world.engine(endings)) as engine:
        await engine.start(with_options(io=Rates(read=5 * MB, write=3 * MB), pids=77))
        host = world.inspect("ann/map")["HostConfig"]
        assert host["PidsLimit"] == 77
        device = disks.underlying_disk(Path(world.api.info()["DockerRootDir"]))
        assert host["BlkioDeviceReadBps"] == ([{"Path": device, "Rate": 5 * MB}] if device else None)


@needs_disks
async def test_disk_survives_the_task_set_and_is_removed_with_its_environment(
    world: DockerWorld, endings: Endings
) -> None:
    async with opened(world.engine(endings)) as first:
        await first.start(with_options(disk=20 * MB))
        assert len(devices(world)) == 1
        await first.close()
        async with opened(world.engine(endings)) as second:
            assert list(second.running()) == ["ann/map"]
            assert len(devices(world)) == 1
            await second.stop("ann/map")
            assert devices(world) == []
            assert not list(world.directory.rglob("*.disk"))


@needs_disks
async def test_disk_of_an_interrupted_start_is_removed(world: DockerWorld, endings: Endings) -> None:
    """The task set was killed after it had made the disk and before it created the container."""
    directory = world.directory / "environments" / "ann" / "map"
    directory.mkdir(parents=True)
    disks.make(directory / f"{spec().run}.disk", 20 * MB, 10000)
    assert len(devices(world)) == 1
    async with opened(world.engine(endings)):
        assert devices(world) == []
        assert world.remains() == set()


async def test_gpus_are_requested_from_docker(world: DockerWorld, endings: Endings) -> None:
    """This machine has no GPU, so Docker's error proves that the request has reached it."""
    async with opened(world.engine(endings, gpus=2)) as engine:
        with pytest.raises(StartFailed, match=r"gpu"):
            await engine.start(with_options(gpus=2))
        assert world.remains() == set()
        with pytest.raises(NoCapacity, match="3 GPUs; 2 of this machine's 2"):
            await engine.start(with_options(gpus=3))


@pytest.mark.parametrize(
    ("label", "fault"), [("LABEL rce.version=0.0.1", "was built for RCE 0.0.1"), ("LABEL x=y", "has no label")]
)
async def test_image_of_another_version_is_refused(
    world: DockerWorld, endings: Endings, label: str, fault: str
) -> None:
    name = f"rce-test/other-{secrets.token_hex(4)}"  # the daemon may be shared with other test runs
    world.api.import_image_from_data(b"\0" * 1024, repository=name, tag="1", changes=[label])
    try:
        async with opened(world.engine(endings)) as engine:
            with pytest.raises(StartFailed, match=f"image {name}:1 {fault}.*{__version__}"):
                await engine.start(with_options(image=f"{name}:1"))
            assert world.remains() == set()
    finally:
        world.api.remove_image(f"{name}:1")
