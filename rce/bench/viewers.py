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
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import msgspec
import psutil
from msgspec import Struct, field

from rce.bench import camera_program, viewer_program
from rce.bench.cores import runs, set_apart
from rce.bench.nodes import PACKAGE, Place
from rce.bench.overtake import CommandStream
from rce.bench.report import aligned
from rce.bench.statistics import percentile
from rce.bench.viewer_program import Seen, Task
from rce.errors import InvalidRequest

ROUNDS = 5
SETTLING = 2.0  # seconds for which viewers watch before the loop is measured
ENDING = 30.0  # seconds until a program is killed that should end
# Cameras and viewers run on other machines in real life, so here they give way to the platform.
ELSEWHERE = ("chrt", "--idle", "0")


class Phase(Struct):
    """Round trips of the control loop in one phase of all rounds.

    Attributes:
        name: What happens beside the loop.
        times: Round trips in seconds.
        images: Images that were sent in the phase.
        seen: What the viewers have seen; None without viewers.
    """

    name: str
    times: list[float] = field(default_factory=list)
    images: int = 0
    seen: Seen | None = None

    def percentile(self, percent: float) -> float:
        """Return a percentile in seconds."""
        return percentile(self.times, percent)


async def measure(place: Place, task: Task, samples: int) -> list[Phase]:
    """Return the phases: quiet, with a camera, and with the viewers of it.

    They take turns in several rounds, since the delays of a shared machine differ more from minute to minute than
    the phases do.

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
    where = {"url": address.url, "environment": environment.tag, "user": address.user}
    access = {"password": address.password, "key": address.key}
    camera_place = msgspec.convert({**where, **access, "robot": f"{place.robot.name}_camera"}, camera_program.Place)
    phases = [Phase("quiet"), Phase("one camera"), Phase(f"and {task.count} viewers", seen=Seen())]
    rounds = min(ROUNDS, samples)
    for number in range(rounds):
        count = len(range(number, samples, rounds))
        await _round(phases, commands, camera_place, msgspec.structs.replace(task, **where, **access), count)
    return phases


async def _round(
    phases: list[Phase], commands: CommandStream, place: camera_program.Place, task: Task, count: int
) -> None:
    """Add `count` commands to each phase."""
    quiet, alone, beside = phases
    await _measure(quiet, commands, count)
    async with film(place) as camera:
        await _measure(alone, commands, count)
        alone.images += await camera.sent()
        before = await camera.sent()
        async with crowd(task) as seen:
            await asyncio.sleep(SETTLING)
            await _measure(beside, commands, count)
            beside.images += await camera.sent() - before
        assert beside.seen is not None
        beside.seen.add(await seen)


async def _measure(phase: Phase, commands: CommandStream, count: int) -> None:
    set_apart(_is_measured)
    phase.times += [each.back for each in await commands.measure(count)]


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
        *ELSEWHERE, sys.executable, "-P", "-m", module, stdin=pipe, stdout=pipe, start_new_session=True
    )
    assert process.stdin is not None
    _give_way(process.pid)
    try:
        yield Program(process)
        process.stdin.close()
        await asyncio.wait_for(process.wait(), ENDING)
    finally:
        if process.returncode is None:
            process.kill()
        await process.wait()


def _give_way(pid: int) -> None:
    """Lower the priority of a process's session: a kernel with autogroups shares the processor among sessions."""
    with suppress(OSError):
        Path(f"/proc/{pid}/autogroup").write_text("19")


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
    quiet = phases[0].percentile(99)
    rows = [
        [each.name, *(f"{each.percentile(at) * 1e3:.2f}" for at in (50, 99)), f"{each.percentile(99) / quiet:.2f}"]
        for each in phases
    ]
    lines, last = list(aligned([head, *rows])), phases[-1]
    if last.seen is not None:
        seen = last.seen
        lines.append(f"{last.images} images sent; encoded {seen.encoded} times, received {seen.messages} times")
        lines.append(f"{seen.bytes / 1e6:.1f} MB to the viewers, {seen.bytes / max(seen.messages, 1):,.0f} bytes each")
    return "\n".join(lines)
