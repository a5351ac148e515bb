"""The camera that many viewers watch."""

from __future__ import annotations

import asyncio
from typing import cast

from rce.bench.camera_program import Camera, moving_image
from rce.bench.payloads import IMAGE
from rce.client import Publisher


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
