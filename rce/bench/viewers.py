"""Many viewers of one camera beside a control loop.

A robot sends VGA images at 30 Hz to an environment, where nobody sees them at first, then many viewers, guests in a
program of their own. Another robot sends velocity commands all the time, whose round trips are measured.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
from msgspec import Struct

from rce.bench import viewer_program
from rce.bench.nodes import PACKAGE, Place
from rce.bench.overtake import CommandStream
from rce.bench.payloads import HEIGHT, IMAGE, ROW, WIDTH, image_cdr
from rce.bench.report import aligned
from rce.bench.statistics import percentile
from rce.bench.viewer_program import TOPIC, TYPE, Seen, Task
from rce.client import Publisher, Robot
from rce.errors import InvalidRequest

FREQUENCY = 30.0  # images per second
SETTLING = 2.0  # seconds for which viewers watch before the loop is measured
HEAD = image_cdr(IMAGE)[:-IMAGE]
STRIPE = 2 * bytes(each for x in range(WIDTH) for each in (x % 256, x // 3 % 256, 128))  # two rows


class Phase(Struct, frozen=True):
    """Round trips of the control loop in one phase.

    Attributes:
        name: What happens beside the loop.
        p50: Median in seconds.
        p99: 99th percentile in seconds.
        images: Images that were sent in the phase.
        seen: What the viewers have seen; None without viewers.
    """

    name: str
    p50: float
    p99: float
    images: int = 0
    seen: Seen | None = None


async def measure(place: Place, task: Task, samples: int) -> list[Phase]:
    """Return the phases: quiet, with a camera, and with the viewers of it.

    Args:
        place: Robot and environment.
        task: What the viewers do; the place fills in where.
        samples: Number of commands of each phase.

    Raises:
        InvalidRequest: The place has no address of the platform.
    """
    if place.address is None:
        raise InvalidRequest("the viewers need the address of the platform")
    address, environment = place.address, place.environment
    await environment.add_node("commands", PACKAGE, "commands")
    commands = CommandStream(
        await environment.publisher("/command", "geometry_msgs/Twist"),
        await environment.subscriber("/arrival", "std_msgs/Float64"),
    )
    await commands.wait_for_node()
    quiet = await _phase("quiet", commands, samples)
    access: dict[str, Any] = {"user": address.user, "password": address.password, "key": address.key}
    async with Robot(address.url, robot=f"{place.robot.name}_camera", **access) as robot:
        camera = Camera(await robot.environment(environment.tag).publisher(TOPIC, TYPE, raw=True))
        filming = asyncio.create_task(camera.film())
        try:
            alone = await _phase("one camera", commands, samples, camera)
            where = {"url": address.url, "environment": environment.tag, **access}
            before = camera.sent
            async with crowd(msgspec.structs.replace(task, **where)) as seen:
                await asyncio.sleep(SETTLING)
                beside = await _phase(f"and {task.count} viewers", commands, samples, camera)
                await asyncio.sleep(SETTLING)
                images = camera.sent - before
            found = await seen
        finally:
            filming.cancel()
            await asyncio.gather(filming, return_exceptions=True)
    return [quiet, alone, msgspec.structs.replace(beside, images=images, seen=found)]


async def _phase(name: str, commands: CommandStream, samples: int, camera: Camera | None = None) -> Phase:
    before = camera.sent if camera is not None else 0
    taken = sorted(each.back for each in await commands.measure(samples))
    images = camera.sent - before if camera is not None else 0
    return Phase(name, percentile(taken, 50), percentile(taken, 99), images)


class Camera:
    """Camera whose images move.

    Attributes:
        sent: Number of images.
    """

    def __init__(self, publisher: Publisher) -> None:
        self.sent = 0
        self._publisher = publisher

    async def film(self) -> None:
        """Send images until cancelled."""
        begun = time.monotonic()
        while True:
            self._publisher.offer(moving_image(self.sent))
            self.sent += 1
            await asyncio.sleep(max(0.0, begun + self.sent / FREQUENCY - time.monotonic()))


def moving_image(number: int) -> bytes:
    """Return CDR of an rgb8 image of 640 x 480: slanted stripes that move from image to image."""
    return HEAD + b"".join(STRIPE[3 * (shift := (number * 4 + y) % WIDTH) : 3 * shift + ROW] for y in range(HEIGHT))


@asynccontextmanager
async def crowd(task: Task) -> AsyncIterator[asyncio.Future[Seen]]:
    """Run the viewers; yields what they have seen, which is known at the end.

    Raises:
        InvalidRequest: They could not connect.
    """
    words = (sys.executable, "-P", "-m", viewer_program.__name__)
    pipe = asyncio.subprocess.PIPE
    program = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe)
    assert program.stdin is not None
    assert program.stdout is not None
    seen: asyncio.Future[Seen] = asyncio.get_running_loop().create_future()
    try:
        program.stdin.write(msgspec.json.encode(task) + b"\n")
        if await program.stdout.readline() != b"ready\n":
            raise InvalidRequest("the viewers could not connect: see their error above")
        yield seen
        program.stdin.close()
        seen.set_result(msgspec.json.decode(await program.stdout.readline(), type=Seen))
    finally:
        if program.returncode is None and not seen.done():
            program.kill()
        await program.wait()


def as_text(phases: list[Phase]) -> str:
    """Return a table in milliseconds, and what the viewers have seen."""
    head = ["control loop, ms", "p50", "p99", "of the quiet p99"]
    rows = [
        [each.name, f"{each.p50 * 1e3:.2f}", f"{each.p99 * 1e3:.2f}", f"{each.p99 / phases[0].p99:.2f}"]
        for each in phases
    ]
    lines, last = list(aligned([head, *rows])), phases[-1]
    if last.seen is not None:
        seen = last.seen
        lines.append(f"{last.images} images sent; encoded {seen.encoded} times, received {seen.messages} times")
        lines.append(f"{seen.bytes / 1e6:.1f} MB to the viewers, {seen.bytes / max(seen.messages, 1):,.0f} bytes each")
    return "\n".join(lines)
