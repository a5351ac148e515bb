"""`rce map`: recorded data through a platform and its mapping node, and the map back."""

from __future__ import annotations

import argparse
import asyncio
import math
import os
import secrets
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from pathlib import Path

import numpy as np

from rce.client import Robot
from rce.commands.platform import Access, add_arguments, platform
from rce.errors import InvalidRequest
from rce.mapping.outputs import trajectory_text, write_atomically, write_outputs
from rce.mapping.recordings import Recording, open_recording
from rce.mapping.robot import MappingRobot, Result, start_node
from rce.mapping.simulation import Accuracy, Simulation, evaluate, simulate
from rce.messages import ParameterValue

Source = Recording | Simulation

MAPPERS = ("graph", "particle")  # as in rce.mapping.mappers, which would compile all kernels here
LINE_EVERY = 5.0  # seconds between lines of progress where there is no terminal
TICK = 0.2


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(
        prog="rce map",
        description="Send recorded laser scans through a platform and write the map that its mapping node makes.",
        epilog="`rce map submit`, `status`, `fetch` and `cancel` have the map service of a platform do this; each has "
        "--help of its own.",
    )
    whole.add_argument("recordings", nargs="*", type=Path, metavar="FILE", help="CARMEN log, ROS 1 or ROS 2 bag")
    whole.add_argument("--simulate", action="store_true", help="a robot simulated in a floor plan instead")
    whole.add_argument(
        "--out", type=Path, default=Path("map"), metavar="DIR", help="for the map's files (default: %(default)s)"
    )
    whole.add_argument("--resolution", type=float, default=0.05, help="metres a cell (default: %(default)s)")
    whole.add_argument(
        "--mapper", choices=MAPPERS, default="graph", help="how the map is made (default: %(default)s); docs/mapping.md"
    )
    whole.add_argument("--particles", type=int, default=30, help="of the mapper particle (default: %(default)s)")
    whole.add_argument("--seed", type=int, default=0, help="of the mapper particle (default: %(default)s)")
    whole.add_argument(
        "--team", action="store_true", help="one robot for each FILE, all at the same time, and one map by all of them"
    )
    whole.add_argument("--scan-topic", default="", help="of a bag with several topics of laser scans")
    whole.add_argument("--odometry-topic", default="", help="of a bag with several topics of odometry")
    add_arguments(whole)
    return whole


def main(arguments: list[str]) -> int:
    words = parser().parse_args(arguments)
    if bool(words.recordings) == words.simulate:
        raise InvalidRequest("give recordings, or --simulate")
    if words.team and (len(words.recordings) < 2 or words.mapper != MAPPERS[0]):
        raise InvalidRequest(f"--team is for several recordings and the mapper {MAPPERS[0]}")
    # Before anything is started: what cannot be read or written is said at once.
    sources: list[Source] = [
        open_recording(path, words.scan_topic, words.odometry_topic) for path in words.recordings
    ] or [simulate()]
    there = next(each for each in (words.out, *words.out.absolute().parents) if each.exists())
    if not there.is_dir() or not os.access(there, os.W_OK):
        wrong = "may not be written" if there.is_dir() else "is not a directory"
        raise InvalidRequest(f"{there} {wrong}: choose another directory with --out")
    asyncio.run(run(words, sources))
    return 0


async def run(words: argparse.Namespace, sources: list[Source]) -> None:
    async with platform(words) as access:
        if words.team:
            save_together(words.out, sources, await build_together(access, sources, parameters(words)))
            return
        for source in sources:
            directory = words.out if len(sources) == 1 else words.out / source.name
            result = await build(access, source, parameters(words))
            written = write_outputs(directory, result.grid, result.trajectory)
            print(f"{result.scans} scans mapped; map in {directory}: {', '.join(path.name for path in written)}")
            if isinstance(source, Simulation):
                print(describe(evaluate(result.grid, result.trajectory, source)))


def save_together(directory: Path, sources: Sequence[Source], results: Sequence[Result]) -> None:
    """A directory for each map, with the trajectory of each robot that is on it."""
    maps: list[tuple[Result, Path]] = []
    for number, (source, result) in enumerate(zip(sources, results, strict=True), 1):
        known = next((path for other, path in maps if np.array_equal(other.grid.cells, result.grid.cells)), None)
        path = known or (directory / f"map_{len(maps) + 1}" if maps else directory)
        if known is None:
            maps.append((result, path))
            write_outputs(path, result.grid, result.trajectory)
        write_atomically(path / f"trajectory_{number}.txt", trajectory_text(result.trajectory))
        print(f"robot {number} ({source.name}): {result.scans} scans mapped, on the map in {path}")
    if len(maps) > 1:
        print(f"{len(maps)} maps: robots on different ones have not found out that they were at the same places")


def describe(accuracy: Accuracy) -> str:
    return (
        f"against the truth of the simulation: poses {100 * accuracy.translation:.1f} cm and "
        f"{math.degrees(accuracy.rotation):.2f}° off on average, {accuracy.walls_found:.0%} of the walls it saw are in "
        f"the map, {accuracy.walls_true:.0%} of the map's walls are real"
    )


def parameters(words: argparse.Namespace) -> dict[str, ParameterValue]:
    """Of the mapping node."""
    return {
        "resolution": words.resolution,
        "mapper": words.mapper,
        "particles": words.particles,
        "seed": words.seed,
    }


async def build(access: Access, source: Source, parameters: Mapping[str, ParameterValue]) -> Result:
    """Map one recording in an environment of its own, which is gone afterwards."""
    name = f"mapper_{secrets.token_hex(4)}"
    progress = Progress(source)
    async with (
        Robot(access.url, user=access.user, robot=name, password=access.password, key=access.key) as robot,
        robot.environment(f"env_{name}", restart="no") as environment,
        MappingRobot(robot, environment) as mapping,
    ):
        await mapping.prepare(parameters)
        progress.begin()
        await mapping.drive(source, progress.done)
        progress.end()
        return await mapping.result()


async def build_together(
    access: Access, sources: Sequence[Source], parameters: Mapping[str, ParameterValue]
) -> list[Result]:
    """Map several recordings at the same time, each by a robot of its own, in one environment whose node joins maps."""
    name = f"team_{secrets.token_hex(4)}"
    tags = [f"robot_{number}" for number, _ in enumerate(sources, 1)]
    async with AsyncExitStack() as stack:
        robots = [
            await stack.enter_async_context(
                Robot(access.url, user=access.user, robot=f"{name}_{tag}", password=access.password, key=access.key)
            )
            for tag in tags
        ]
        environment = await stack.enter_async_context(robots[0].environment(f"env_{name}", restart="no"))
        await start_node(environment, "team", {**parameters, "robots": [*tags]})
        team = [
            await stack.enter_async_context(MappingRobot(robot, robot.environment(environment.tag), f"/{tag}"))
            for robot, tag in zip(robots, tags, strict=True)
        ]
        await asyncio.gather(*(each.wire() for each in team))
        progress = [Progress(source) for source in sources]
        for each in progress:
            each.begin()
        await asyncio.gather(
            *(each.drive(source, told.done) for each, source, told in zip(team, sources, progress, strict=True))
        )
        for each in progress:
            each.end()
        return list(await asyncio.gather(*(each.result() for each in team)))


class Progress:
    """Scans, how many times real time, and the time to go, on standard error."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._began = 0.0
        self._shown = 0.0
        self._count = 0
        self._terminal = sys.stderr.isatty()

    def begin(self) -> None:
        self._began = self._shown = time.monotonic()

    def done(self, count: int) -> None:
        self._count = count
        now = time.monotonic()
        if now - self._shown >= (TICK if self._terminal else LINE_EVERY):
            self._shown = now
            self._show("\r" if self._terminal else "", "" if self._terminal else "\n")

    def end(self) -> None:
        self._show("\r" if self._terminal else "", "\n")

    def _show(self, start: str, end: str) -> None:
        passed = max(time.monotonic() - self._began, 1e-9)
        text = f"{self._source.name}: {self._count} scans"
        total, duration = self._source.scans, self._source.duration
        if total:
            share = self._count / total
            text = f"{self._source.name}: {self._count}/{total} scans"
            if duration:
                text += f", {share * duration / passed:.1f} times real time"
            if 0 < share < 1:
                text += f", {passed / share - passed:.0f} s to go"
        print(f"{start}{text}, {passed:.1f} s", end=end.ljust(4) if start else end, file=sys.stderr, flush=True)
