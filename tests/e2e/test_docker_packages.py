# ruff: noqa: E402  (imports after importorskip)
"""Users' packages in containers: pushed packages as read-only mounts, packages that need installation as an image."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.e2e.pushed_packages import answer, echo, rce
from tests.support.e2e.real_platform import USER, RealPlatform, containers, until
from tests.support.paths import TEST_PACKAGE, TESTS

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from rce import __version__
from rce.errors import LimitExceeded

WORKSPACE = TESTS / "e2e" / "workspace"
pytestmark = pytest.mark.skipif(
    sys.version_info[:2] != (3, 11), reason="types are built for this Python, and the images have 3.11"
)


@pytest.fixture(scope="module")
async def contained_bare(
    arguments: list[str], images: Any, tmp_path_factory: pytest.TempPathFactory
) -> AsyncIterator[RealPlatform]:
    """A platform with the engine `docker` that has no types of its own."""
    words = ["--engine", "docker", "--typesupport", ""]
    async with RealPlatform(tmp_path_factory.mktemp("contained"), *words) as platform:
        yield platform
    assert containers(images, platform) == []


async def test_pushed_package_is_mounted_where_requested(contained_bare: RealPlatform, images: Any) -> None:
    await rce("package", "push", str(TEST_PACKAGE), "--url", contained_bare.url)
    cache = contained_bare.directory / "data/container/packages"
    async with contained_bare.robot("r1") as robot:
        async with robot.environment("plain"):
            assert not _mounts(images, contained_bare, "plain", cache)
        async with robot.environment("brain", packages=["Test"]) as brain:
            (mount,) = _mounts(images, contained_bare, "brain", cache)
            assert not mount["RW"]
            await brain.add_node("echo", "Test", "stringEcho.py")
            await echo(brain)
            (container,) = containers(images, contained_bare, "brain")
            words = ["sh", "-c", f"exec 2>&1; ls {cache}; touch {mount['Destination']}/x"]
            call = images.exec_create(container["Id"], words)
            seen = (await asyncio.to_thread(images.exec_start, call["Id"])).decode()
            assert seen.splitlines()[0] == Path(mount["Source"]).name
            assert "Read-only file system" in seen
    await until(lambda: not list((cache / "uses").iterdir()))


def _mounts(api: Any, platform: RealPlatform, tag: str, cache: Path) -> list[dict[str, Any]]:
    (container,) = containers(api, platform, tag)
    mounts: list[dict[str, Any]] = api.inspect_container(container["Id"])["Mounts"]
    return [mount for mount in mounts if mount["Source"].startswith(str(cache))]


async def test_image_of_a_user_has_its_packages(contained_bare: RealPlatform, images: Any) -> None:
    master = str(contained_bare.directory / "data/master")
    async with contained_bare.robot("r1") as robot:
        with pytest.raises(LimitExceeded, match="image"):
            await robot.create_environment("early", image=f"users/{USER.lower()}/workspace")
        name = (await rce("image", "build", str(WORKSPACE), "--for", USER, "--data-dir", master)).strip()
        assert name == f"users/{USER.lower()}/workspace"
        async with asyncio.timeout(120):
            while not await _created(robot, name):  # noqa: ASYNC110
                await asyncio.sleep(0.5)  # the Master notices changes by another process within seconds
        async with robot.environment("brain", image=name) as brain:
            await brain.add_node("greeter", "greeter", "greet")
            greeting = await answer(brain, "/greet", "greeter_msgs/Greet", {"name": "robot"})
            assert greeting == {"text": "hello robot"}
    images.remove_image(f"{name}:{__version__}", force=True)


async def _created(robot: Any, image: str) -> bool:
    try:
        await robot.create_environment("probe", image=image)
    except LimitExceeded:
        return False
    await robot.destroy_environment("probe")
    return True
