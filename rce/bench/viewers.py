"""Many viewers of one camera beside a control loop.

A robot in a program of its own sends VGA images at 30 Hz to an environment, where nobody sees them at first, then many
viewers, guests in another program. The robot of this process sends velocity commands all the time, whose round trips
are measured. It and the Robot endpoint of the bench's own platform have a core of their own, if there are two.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import msgspec
import psutil
from msgspec import Struct

from rce.bench import camera_program, viewer_program
from rce.bench.cores import runs, set_apart
from rce.bench.nodes import PACKAGE, Place
from rce.bench.overtake import CommandStream
from rce.bench.report import aligned
from rce.bench.statistics import percentile
from rce.bench.viewer_program import Seen, Task
from rce.errors import InvalidRequest

SETTLING = 2.0  # seconds for which viewers watch before the loop is measured
ENDING = 30.0  # seconds until a program is killed that should end
# Cameras and viewers run on other machines in real life, so here they run only while the platform does not.
ELSEWHERE = ("chrt", "--idle", "0")


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
    where = {"url": address.url, "environment": environment.tag, "user": address.user}
    access = {"password": address.password, "key": address.key}
    async with film(
        msgspec.convert({**where, **access, "robot": f"{place.robot.name}_camera"}, camera_program.Place)
    ) as camera:
        alone = await _phase("one camera", commands, samples, camera)
        before = await camera.sent()
        async with crowd(msgspec.structs.replace(task, **where, **access)) as seen:
            await asyncio.sleep(SETTLING)
            beside = await _phase(f"and {task.count} viewers", commands, samples, camera)
            await asyncio.sleep(SETTLING)
            images = await camera.sent() - before
        found = await seen
    return [quiet, alone, msgspec.structs.replace(beside, images=images, seen=found)]


async def _phase(name: str, commands: CommandStream, samples: int, camera: Camera | None = None) -> Phase:
    before = await camera.sent() if camera is not None else 0
    set_apart(_is_measured)
    taken = sorted(each.back for each in await commands.measure(samples))
    images = await camera.sent() - before if camera is not None else 0
    return Phase(name, percentile(taken, 50), percentile(taken, 99), images)


def _is_measured(process: psutil.Process) -> bool:
    return process.pid == os.getpid() or runs(process, "endpoints.robot")


class Program:
    """A program of the bench, which reads and writes lines."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def ask(self, line: bytes = b"") -> bytes:
        """Send a line; return the next one that the program writes, which is empty if it has ended."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(line + b"\n")
        return await self._process.stdout.readline()

    async def end(self) -> bytes:
        """End its standard input; return the next line that it writes."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        return await self._process.stdout.readline()


@asynccontextmanager
async def program(module: str) -> AsyncIterator[Program]:
    """Run a module until its standard input ends, or kill it."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *ELSEWHERE, sys.executable, "-P", "-m", module, stdin=pipe, stdout=pipe
    )
    assert process.stdin is not None
    try:
        yield Program(process)
        process.stdin.close()
        await asyncio.wait_for(process.wait(), ENDING)
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


class Camera:
    """Camera of another process."""

    def __init__(self, program: Program) -> None:
        self._program = program

    async def sent(self) -> int:
        """Return the number of images that it has sent."""
        return int(await self._program.ask())


@asynccontextmanager
async def film(place: camera_program.Place) -> AsyncIterator[Camera]:
    """Run the camera.

    Raises:
        InvalidRequest: It could not connect.
    """
    async with program(camera_program.__name__) as camera:
        if await camera.ask(msgspec.json.encode(place)) != b"0\n":
            raise InvalidRequest("the camera could not connect: see its error above")
        yield Camera(camera)


@asynccontextmanager
async def crowd(task: Task) -> AsyncIterator[asyncio.Future[Seen]]:
    """Run the viewers; yields what they have seen, which is known at the end.

    Raises:
        InvalidRequest: They could not connect.
    """
    seen: asyncio.Future[Seen] = asyncio.get_running_loop().create_future()
    async with program(viewer_program.__name__) as viewers:
        if await viewers.ask(msgspec.json.encode(task)) != b"ready\n":
            raise InvalidRequest("the viewers could not connect: see their error above")
        yield seen
        seen.set_result(msgspec.json.decode(await viewers.end(), type=Seen))


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
