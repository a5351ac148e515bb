"""Viewers of one camera beside a control loop."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from pathlib import Path
from typing import cast

import pytest

from rce.bench import viewers
from rce.bench.payloads import IMAGE
from rce.bench.viewer_program import Seen, Task
from rce.bench.viewers import Camera, Phase, as_text, crowd, moving_image
from rce.client import Publisher
from rce.errors import InvalidRequest
from tests.support.bench import fake_place


class Offered:
    """Publisher that keeps what it is offered."""

    def __init__(self) -> None:
        self.images: list[bytes] = []
        self.some = asyncio.Event()

    def offer(self, image: bytes) -> bool:
        self.images.append(image)
        if len(self.images) > 2:
            self.some.set()
        return True


async def test_camera_sends_images_that_move() -> None:
    offered = Offered()
    camera = Camera(cast(Publisher, offered))
    filming = asyncio.create_task(camera.film())
    await asyncio.wait_for(offered.some.wait(), 30)
    filming.cancel()
    assert camera.sent >= len(offered.images) - 1
    assert len(set(offered.images[:3])) == 3
    assert {len(each) for each in offered.images} == {len(moving_image(0))}
    assert len(moving_image(7)) > IMAGE


async def test_place_without_an_address_is_refused() -> None:
    async with AsyncExitStack() as stack:
        place, *_ = fake_place(stack)
        with pytest.raises(InvalidRequest, match="address of the platform"):
            await viewers.measure(place._replace(address=None), Task(1), 1)


READY = "import sys\nsys.stdin.readline()\nprint('ready', flush=True)\nsys.stdin.read()\nprint('{\"messages\":1}')\n"


def stand_in(script: str, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a script take the place of the program."""
    (directory / "stand_in.py").write_text(script)
    monkeypatch.setenv("PYTHONPATH", str(directory))
    monkeypatch.setattr(viewers.viewer_program, "__name__", "stand_in")


async def test_viewers_say_in_the_end_what_they_have_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(READY, tmp_path, monkeypatch)
    async with crowd(Task(1)) as seen:
        pass
    assert await seen == Seen(messages=1)


async def test_viewers_that_cannot_connect_are_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in("import sys\nsys.exit('cannot connect')\n", tmp_path, monkeypatch)
    with pytest.raises(InvalidRequest, match="could not connect"):
        async with crowd(Task(1)):
            pass


def test_table_says_how_often_images_were_encoded() -> None:
    seen = Seen(messages=100, bytes=5_000_000, encoded=20)
    table = as_text([Phase("quiet", 0.001, 0.002), Phase("and 5 viewers", 0.002, 0.003, 21, seen)])
    assert "1.50" in table
    assert "21 images sent; encoded 20 times, received 100 times" in table
