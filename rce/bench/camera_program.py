"""Program of `rce bench viewers`: a robot whose camera films at 30 Hz, until the standard input ends.

It has a process of its own: to make and send images takes milliseconds, which must not delay the robot whose control
loop is measured. It reads a `Place` as one line of JSON and writes `0`; for each further line it writes the number of
images that it has sent.
"""

from __future__ import annotations

import asyncio
import sys
import time

import msgspec
import uvloop
from msgspec import Struct

from rce.bench.payloads import HEIGHT, IMAGE, ROW, WIDTH, image_cdr
from rce.bench.viewer_program import TOPIC, TYPE
from rce.client import Publisher, Robot

FREQUENCY = 30.0  # images per second
DIFFERENT = 20  # images, made beforehand: a real camera takes no time of the platform's processor
HEAD = image_cdr(IMAGE)[:-IMAGE]
STRIPE = 2 * bytes(each for x in range(WIDTH) for each in (x % 256, x // 3 % 256, 128))  # two rows


class Place(Struct, frozen=True):
    """Address of the platform, environment, name of the robot, and user with a password or an API key."""

    url: str
    environment: str
    robot: str
    user: str
    password: str | None = None
    key: str | None = None


class Camera:
    """Camera whose images move.

    Attributes:
        sent: Number of images.
    """

    def __init__(self, publisher: Publisher) -> None:
        self.sent = 0
        self._publisher = publisher
        self._images = [moving_image(number) for number in range(DIFFERENT)]

    async def film(self) -> None:
        """Send images until cancelled."""
        begun = time.monotonic()
        while True:
            self._publisher.offer(self._images[self.sent % DIFFERENT])
            self.sent += 1
            await asyncio.sleep(max(0.0, begun + self.sent / FREQUENCY - time.monotonic()))


def moving_image(number: int) -> bytes:
    """Return CDR of an rgb8 image of 640 x 480: slanted stripes, which move by the width in `DIFFERENT` images."""
    step = WIDTH // DIFFERENT
    return HEAD + b"".join(STRIPE[3 * (shift := (number * step + y) % WIDTH) : 3 * shift + ROW] for y in range(HEIGHT))


async def run(place: Place) -> None:
    """Film until the standard input ends."""
    async with Robot(place.url, user=place.user, robot=place.robot, password=place.password, key=place.key) as robot:
        camera = Camera(await robot.environment(place.environment).publisher(TOPIC, TYPE, raw=True))
        print(camera.sent, flush=True)
        filming = asyncio.create_task(camera.film())
        while await asyncio.to_thread(sys.stdin.readline):
            print(camera.sent, flush=True)
        filming.cancel()
        await asyncio.gather(filming, return_exceptions=True)


if __name__ == "__main__":
    uvloop.run(run(msgspec.json.decode(sys.stdin.readline(), type=Place)))
