# ruff: noqa: E402  (Docker is imported only where it is there)
"""What a robot hears when its environment does not start, ends, or uses up what it has: the reason and last lines."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest
from real_platform import RealPlatform, containers
from test_kills import next_event

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from provisioning.image import BASE
from rce import __version__
from rce.errors import LimitExceeded, StartFailed
from rce.messages import EnvironmentEvent, LimitEvent

MB = 1024 * 1024
LABEL = f"LABEL rce.version={__version__}"
LAST_WORDS = 'ENTRYPOINT ["sh", "-c", "echo the last words; exit 3", "--"]'


@pytest.fixture(scope="module")
def odd_images(images: Any) -> Iterator[None]:
    """Of another version; without any program; one whose endpoint ends at once."""
    api, names = images, [f"{BASE}:{tag}" for tag in ("old", "empty", "short")]
    api.import_image_from_data(b"\0" * 1024, repository=BASE, tag="old", changes=["LABEL rce.version=0.0.1"])
    api.import_image_from_data(b"\0" * 1024, repository=BASE, tag="empty", changes=[LABEL])
    made = api.create_container(f"{BASE}:{__version__}", "true")
    api.commit(made["Id"], repository=BASE, tag="short", changes=[LAST_WORDS])
    api.remove_container(made["Id"])
    yield
    for name in names:
        api.remove_image(name)


@pytest.mark.parametrize(
    ("image", "error", "said"),
    [
        ("rce/base:9.9", StartFailed, ["no image rce/base:9.9", "provision image"]),
        ("rce/base:old", StartFailed, ["was made for RCE 0.0.1", f"this is RCE {__version__}"]),
        ("rce/base:empty", StartFailed, ["did not start", "executable file not found"]),
        ("rce/base:short", StartFailed, ["ended with status 3", "the last words"]),
        ("debian:bookworm", LimitExceeded, ["debian:bookworm", "rce/base"]),
    ],
)
async def test_a_start_that_fails(
    contained: RealPlatform, odd_images: None, image: str, error: type[Exception], said: list[str]
) -> None:
    async with contained.robot("reporter1") as robot:
        with pytest.raises(error) as raised:
            await robot.create_environment("failing", image=image)
        assert all(part in str(raised.value) for part in said), str(raised.value)


async def test_the_image_that_was_asked_for_runs(contained: RealPlatform, images: Any) -> None:
    async with contained.robot("reporter2") as robot, robot.environment("small", image="rce/base"):
        (container,) = containers(images, contained)
        assert container["Image"] == f"rce/base:{__version__}"


async def test_an_environment_that_ends(contained: RealPlatform, images: Any) -> None:
    async with contained.robot("reporter3") as robot:
        events = robot.events()
        await robot.create_environment("ending", restart="no")
        (container,) = containers(images, contained)
        await asyncio.to_thread(images.kill, container["Id"])
        while (event := await next_event(events, EnvironmentEvent)).state != "gone":
            pass
        assert "signal 9" in event.reason


async def test_a_process_that_uses_up_the_memory(contained: RealPlatform, images: Any) -> None:
    """It is ended, its environment works on, and the robot is told."""
    async with contained.robot("reporter4") as robot, robot.environment("tight", memory=250 * MB) as tight:
        events = robot.events()
        (container,) = containers(images, contained)
        hog = images.exec_create(container["Id"], ["python3", "-c", "x = [bytearray(1 << 20) for _ in range(1000)]"])
        await asyncio.to_thread(images.exec_start, hog["Id"])
        assert images.exec_inspect(hog["Id"])["ExitCode"] == 137
        assert "environment tight: its memory was used up" in (await next_event(events, LimitEvent)).reason
        await tight.add_node("echo", "rce_demo", "echo.py")
