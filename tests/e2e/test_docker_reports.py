# ruff: noqa: E402  (imports after importorskip)
"""Reports to a robot whose environment does not start, ends or reaches a limit, with the reason and last lines."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.e2e.real_platform import RealPlatform, containers
from tests.support.e2e.traffic import next_event

docker = pytest.importorskip("docker", reason="needs docker-py: pip install '.[docker]'")

from provisioning.image import BASE
from rce import __version__
from rce.errors import LimitExceeded, StartFailed
from rce.protocol.messages import EnvironmentEvent, LimitEvent

MB = 1024 * 1024
LABEL = f"LABEL rce.version={__version__}"
LAST_WORDS = 'ENTRYPOINT ["sh", "-c", "echo the last words; exit 3", "--"]'


@pytest.fixture(scope="module")
def odd_images(images: Any) -> Iterator[None]:
    """Images of another version, without any program, and with an endpoint that ends at once."""
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
    ("image", "error", "parts"),
    [
        ("rce/base:9.9", StartFailed, ["no image rce/base:9.9", "provision image"]),
        ("rce/base:old", StartFailed, ["was built for RCE 0.0.1", f"this is RCE {__version__}"]),
        ("rce/base:empty", StartFailed, ["did not start", "executable file not found"]),
        ("rce/base:short", StartFailed, ["ended with status 3", "the last words"]),
        ("debian:bookworm", LimitExceeded, ["debian:bookworm", "rce/base"]),
    ],
)
async def test_failed_start_has_a_reason(
    contained: RealPlatform, odd_images: None, image: str, error: type[Exception], parts: list[str]
) -> None:
    async with contained.robot("reporter1") as robot:
        with pytest.raises(error) as raised:
            await robot.create_environment("failing", image=image)
        assert all(part in str(raised.value) for part in parts), str(raised.value)


async def test_requested_image_is_used(contained: RealPlatform, images: Any) -> None:
    async with contained.robot("reporter2") as robot, robot.environment("small", image="rce/base"):
        (container,) = containers(images, contained, "small")
        assert container["Image"] == f"rce/base:{__version__}"


async def test_end_of_an_environment_is_reported(contained: RealPlatform, images: Any) -> None:
    async with contained.robot("reporter3") as robot:
        events = robot.events()
        await robot.create_environment("ending", restart="no")
        (container,) = containers(images, contained, "ending")
        await asyncio.to_thread(images.kill, container["Id"])
        while (event := await next_event(events, EnvironmentEvent)).state != "gone":
            pass
        assert "signal 9" in event.reason


async def test_killed_process_is_reported_and_environment_continues(contained: RealPlatform, images: Any) -> None:
    """A process beyond the memory limit is killed, its environment works on, and the robot gets an event."""
    async with contained.robot("reporter4") as robot, robot.environment("tight", memory=250 * MB) as tight:
        events = robot.events()
        (container,) = containers(images, contained, "tight")
        hog = images.exec_create(container["Id"], ["python3", "-c", "x = [bytearray(1 << 20) for _ in range(1000)]"])
        await asyncio.to_thread(images.exec_start, hog["Id"])
        assert images.exec_inspect(hog["Id"])["ExitCode"] == 137
        assert "environment tight: it reached its memory limit" in (await next_event(events, LimitEvent)).reason
        await tight.add_node("echo", "rce_demo", "echo.py")
