"""A run over one profile: the platform, an operator in the cloud, and the robot behind the emulated line."""

from __future__ import annotations

import asyncio
import secrets
import sys
import time
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import IO

import msgspec
from msgspec import Struct

from rce.bench.network import streams
from rce.bench.network.lab import Lab, lab
from rce.bench.network.line import PROFILES, Outage
from rce.bench.network.robot import DOWN, UP, ticks
from rce.bench.network.streams import STREAMS, Arrivals
from rce.client import Publisher, Robot
from rce.errors import RceError, StartFailed
from rce.process.supervisor import ManagedProcess

USER = "testUser"  # user of the development mode; the password is the same
READY = 60.0  # seconds until the robot exchanges messages
LEAST = 20.0  # seconds after the last outage


class Result(Struct):
    """Result of a run over one profile in one mode.

    Attributes:
        profile: Name of the profile.
        mode: `rce` or `plain`.
        seconds: Duration.
        streams: What arrived, by stream; of the service, its answers.
        ended: When outages ended and addresses changed, on the clock of the messages.
    """

    profile: str
    mode: str
    seconds: float
    streams: dict[str, Arrivals]
    ended: list[float] = []


async def measure(profile: str, mode: str, seconds: float, directory: Path, log: IO[str]) -> Result:
    """Let the robot and the operator exchange all streams.

    Args:
        profile: Name of the line's profile.
        mode: Mode of the robot: `rce` or `plain`.
        seconds: Duration; longer if the profile has outages or changes of the address later.
        directory: Directory for the platform's data.
        log: File for the logs of its processes.

    Raises:
        Unavailable: This process is not root, or a program is missing.
        StartFailed: The platform or the robot did not start.
    """
    line = PROFILES[profile]
    events = [*(outage.start + outage.length for outage in line.outages), *line.moves]
    seconds = max(seconds, *(event + LEAST for event in events)) if events else seconds
    async with lab(profile) as place, _platform(place.address, directory, log) as url:
        result = Result(profile, mode, seconds, {})
        async with Robot(url, user=USER, robot=streams.OPERATOR, password=USER) as operator:
            await _exchange(place, url, operator, result, log)
    return result


@asynccontextmanager
async def _platform(address: str, directory: Path, log: IO[str]) -> AsyncIterator[str]:
    """Start a Master and a Robot endpoint at an address; yield the URL of the entry.

    The development mode, which makes the user, serves the loopback address only. So a Master that makes it runs first.
    """
    token = secrets.token_hex(32)

    def master_words(host: str = address) -> list[str]:
        ports = [f"--http=tcp:0:interface={host}", "--control=tcp:0:interface=127.0.0.1"]
        return [f"--data-dir={directory / 'master'}", *ports]

    def robot_words() -> list[str]:
        assert master.ready is not None
        where = [f"--data-dir={directory / 'robot'}", f"--master={master.ready.control}", "--name=robot-1"]
        return [*where, f"--ws-host={address}", "--ws-port=0"]

    master = ManagedProcess("master", master_words, {"RCE_TOKENS": f"robot:robot-1:{token}"}, log)
    robot = ManagedProcess("robot", robot_words, {"RCE_TOKEN": token}, log)
    maker = ManagedProcess("master", lambda: [*master_words("127.0.0.1"), "--dev"], {}, log)
    try:
        await maker.start()
    finally:
        await maker.stop()
    try:
        ready = await master.start()
        await robot.start()
        yield ready.url
    finally:
        await robot.stop()
        await master.stop()


async def _exchange(place: Lab, url: str, operator: Robot, result: Result, log: IO[str]) -> None:
    """Start the robot, and take part until it ends."""
    arrived = {stream.name: Arrivals() for stream in UP}
    for stream in UP:
        await operator.subscriber(stream.name, streams.TYPE, raw=True, callback=arrived[stream.name].add_cdr)
    publishers = [await operator.publisher(stream.name, streams.TYPE, raw=True) for stream in DOWN]
    await operator.service_provider(streams.SERVICE, streams.SERVICE_TYPE, lambda _: {"success": True, "message": ""})
    words = ("--url", url, "--user", USER, "--password", USER, "--mode", result.mode, "--seconds", str(result.seconds))
    program = (*place.prefix, sys.executable, "-P", "-m", "rce.bench.network.robot", *words)
    process = await asyncio.create_subprocess_exec(*program, stdout=PIPE, stderr=log)
    try:
        assert process.stdout is not None
        async with asyncio.timeout(READY):
            if await process.stdout.readline() != b"ready\n":
                raise StartFailed("the robot ended at once; see the log")
            await _connect(operator)
        sending = [asyncio.create_task(_send(each, result)) for each in publishers]
        events = asyncio.create_task(_fail(place, result))
        lines = [line async for line in process.stdout]
        await asyncio.gather(*sending, events)
    except BaseException:
        with suppress(ProcessLookupError):
            process.kill()
        raise
    finally:
        await process.wait()
    found = msgspec.json.decode(lines[-1], type=dict[str, Arrivals])
    result.streams = found | arrived  # the robot knows what it got, and the operator what came from the robot


async def _connect(operator: Robot) -> None:
    """Connect the interfaces of both, as soon as those of the robot exist."""
    for name in (*(stream.name for stream in STREAMS), streams.SERVICE):
        while True:
            try:
                await operator.connect(f"{streams.OPERATOR}/{name}", f"{streams.ROBOT}/{name}")
                break
            except RceError:
                await asyncio.sleep(0.05)


async def _send(publisher: Publisher, result: Result) -> None:
    """Send a stream of the operator to the end."""
    (stream,) = (stream for stream in DOWN if stream.name == publisher.tag)
    async for _ in ticks(stream.period, time.monotonic() + result.seconds):
        publisher.offer(streams.cdr(stream.size))


async def _fail(place: Lab, result: Result) -> None:
    """Let the outages and the changes of the address come."""
    line, began = PROFILES[result.profile], time.monotonic()
    for event in sorted([*line.outages, *(Outage(at, 0.0) for at in line.moves)], key=lambda each: each.start):
        await asyncio.sleep(began + event.start - time.monotonic())
        if event.length:
            place.set_up(False)
            await asyncio.sleep(began + event.start + event.length - time.monotonic())
            place.set_up(True)
        else:
            place.move()
        result.ended.append(time.monotonic())
