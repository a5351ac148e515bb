"""Implementation of `rce map`: recordings are sent to the mapping node of an environment, which returns the map."""

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
from typing import NamedTuple

import numpy as np

from rce.api.map_jobs import MAX_PARALLEL
from rce.cli.commands.maps import MAPPERS
from rce.cli.contexts import Access
from rce.cli.platform import platform
from rce.cli.session import ConsoleSession
from rce.client import Robot
from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation import Accuracy, Simulation, evaluate, simulate
from rce.mapping.files.outputs import trajectory_text, write_atomically, write_outputs
from rce.mapping.files.recordings import Recording, open_recording
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel import run as parallel
from rce.mapping.robot import MappingRobot, Result, start_node
from rce.mapping.scan_cutting import Band
from rce.protocol.messages import ParameterValue

Source = Recording | Simulation

TERMINAL_INTERVAL, LINE_INTERVAL = 0.2, 5.0  # seconds between reports of progress on a terminal, and elsewhere


def run(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Map the recordings, or the simulated drive, and write the maps.

    Raises:
        InvalidRequest: Wrong options, or a file that cannot be read or written, before a platform is started.
    """
    if bool(args.recordings) == args.simulate:
        raise InvalidRequest("give recordings, or --simulate")
    if args.team and (len(args.recordings) < 2 or args.mapper != MAPPERS[0]):
        raise InvalidRequest(f"--team needs several recordings and the mapper {MAPPERS[0]}")
    if not 1 <= args.parallel <= MAX_PARALLEL:
        raise InvalidRequest(f"--parallel: {args.parallel} is not a number from 1 to {MAX_PARALLEL}")
    if args.parallel > 1 and (args.team or args.simulate):
        raise InvalidRequest("--parallel maps recordings as a whole: give it without --team and --simulate")
    sources: list[Source] = [_open(path, args) for path in args.recordings] or [simulate()]
    existing = next(path for path in (args.out, *args.out.absolute().parents) if path.exists())
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        fault = "is not writable" if existing.is_dir() else "is not a directory"
        raise InvalidRequest(f"{existing} {fault}: choose another directory with --out")
    asyncio.run(_map(args, sources))


def _open(path: Path, args: argparse.Namespace) -> Recording:
    """Open a recording; ask for the topic of scans if there are several and this is a terminal.

    Raises:
        InvalidRequest: The recording cannot be read, or has no such topic.
    """
    band = heights(args.heights)
    recording = open_recording(path, args.scan_topic, args.odometry_topic, band)
    topics = getattr(recording, "scan_topics", {})  # a CARMEN log has none
    if args.scan_topic or len(topics) < 2:
        return recording
    usual = max(sorted(topics), key=lambda name: topics[name])
    found = ", ".join(f"{name} ({count} scans)" for name, count in sorted(topics.items()))
    print(f"{path} has several topics of laser scans: {found}", file=sys.stderr)
    if not sys.stdin.isatty():
        print(f"{usual} is mapped; choose another one with --scan-topic", file=sys.stderr)
        return recording
    chosen = input(f"topic to map [{usual}]: ").strip()
    return open_recording(path, chosen, args.odometry_topic, band) if chosen else recording


def heights(words: str) -> Band:
    """Return the band of heights that becomes a scan.

    Raises:
        InvalidRequest: The text is not two numbers in order.
    """
    try:
        low, high = (float(word) for word in words.split(","))
    except ValueError:
        raise InvalidRequest(f"--heights: {words!r} is not LOW,HIGH: two numbers in metres") from None
    if not -math.inf < low < high < math.inf:
        raise InvalidRequest("--heights: LOW must be less than HIGH")
    return Band(low, high)


async def _map(args: argparse.Namespace, sources: list[Source]) -> None:
    async with platform(args) as access:
        if args.team or args.parallel > 1:
            results = await (map_in_parallel if args.parallel > 1 else map_as_team)(access, sources, args)
            save_team_maps(args.out, sources, results)
            return
        for source in sources:
            directory = args.out if len(sources) == 1 else args.out / source.name
            result = await map_alone(access, source, node_parameters(args))
            written = write_outputs(directory, result.grid, result.trajectory)
            print(f"{result.scans} scans mapped; map in {directory}: {', '.join(path.name for path in written)}")
            if isinstance(source, Simulation):
                print(describe(evaluate(result.grid, result.trajectory, source)))


def save_team_maps(directory: Path, sources: Sequence[Source], results: Sequence[Result]) -> None:
    """Write each distinct map to a directory of its own, with the trajectories of the robots that are on it."""
    maps: list[list[int]] = []  # numbers of the robots on each
    for number, result in enumerate(results):
        same = (each for each in maps if np.array_equal(results[each[0]].grid.cells, result.grid.cells))
        known = next(same, None)
        if known is None:
            maps.append([number])
        else:
            known.append(number)
    paths = {}
    for place, robots in enumerate(maps, 1):
        path = directory / f"map_{place}" if place > 1 else directory
        write_outputs(path, results[robots[0]].grid, *(results[each].trajectory for each in robots))
        paths.update(dict.fromkeys(robots, path))
    for number, (source, result) in enumerate(zip(sources, results, strict=True)):
        path = paths[number]
        write_atomically(path / f"trajectory_{number + 1}.txt", trajectory_text(result.trajectory))
        print(f"robot {number + 1} ({source.name}): {result.scans} scans mapped, on the map in {path}")
    if len(maps) > 1:
        print(f"{len(maps)} maps: no overlap was found between robots on different maps")


def describe(accuracy: Accuracy) -> str:
    """Return the accuracy of a map of the simulation as a sentence."""
    return (
        f"compared with the simulation's ground truth: poses {100 * accuracy.translation:.1f} cm and "
        f"{math.degrees(accuracy.rotation):.2f}° off on average, {accuracy.walls_found:.0%} of the walls that "
        f"the robot saw are in the map, {accuracy.walls_true:.0%} of the map's walls are real"
    )


def node_parameters(args: argparse.Namespace) -> dict[str, ParameterValue]:
    """Return the parameters of the mapping node."""
    return {
        "resolution": args.resolution,
        "mapper": args.mapper,
        "particles": args.particles,
        "seed": args.seed,
    }


async def map_alone(access: Access, source: Source, parameters: Mapping[str, ParameterValue]) -> Result:
    """Map one recording in an environment of its own, which is removed afterwards."""
    name = f"mapper_{secrets.token_hex(4)}"
    progress = Progress(source)
    async with (
        Robot(access.url, user=access.user, robot=name, password=access.password, key=access.key) as robot,
        robot.environment(f"env_{name}", restart="no") as environment,
        MappingRobot(robot, environment) as mapping,
    ):
        await mapping.prepare(parameters)
        progress.begin()
        await mapping.drive(source, progress.update)
        progress.end()
        return await mapping.result()


async def map_in_parallel(access: Access, sources: Sequence[Source], args: argparse.Namespace) -> list[Result]:
    """Map several recordings, or the pieces of one, by workers in environments of their own."""
    name = f"mapper_{secrets.token_hex(4)}"
    settings = MapperSettings(args.resolution, particles=args.particles, seed=args.seed)
    progress = Progress(Together.of(sources))
    async with Robot(access.url, user=access.user, robot=name, password=access.password, key=access.key) as robot:
        progress.begin()
        done = await parallel.run(
            robot, f"env_{name}", sources, parallel.Method(args.parallel, args.mapper, settings), progress.update
        )
        progress.end()
    if done.lost:
        print(f"{done.lost} workers were lost and replaced", file=sys.stderr)
    results = {
        number: Result(joint.grid, trajectory, len(trajectory))
        for joint in done.maps
        for number, trajectory in joint.trajectories.items()
    }
    return [results[number] for number in range(len(sources))]


async def map_as_team(access: Access, sources: Sequence[Source], args: argparse.Namespace) -> list[Result]:
    """Map several recordings at the same time, each as a robot of its own, in one environment whose node joins maps."""
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
        await start_node(environment, "team", {**node_parameters(args), "robots": [*tags]})
        team = [
            await stack.enter_async_context(MappingRobot(robot, robot.environment(environment.tag), f"/{tag}"))
            for robot, tag in zip(robots, tags, strict=True)
        ]
        await asyncio.gather(*(each.wire() for each in team))
        progress = [Progress(source) for source in sources]
        for each in progress:
            each.begin()
        await asyncio.gather(
            *(each.drive(source, report.update) for each, source, report in zip(team, sources, progress, strict=True))
        )
        for each in progress:
            each.end()
        return list(await asyncio.gather(*(each.result() for each in team)))


class Together(NamedTuple):
    """Recordings that are mapped at the same time.

    Attributes:
        name: Names of the recordings.
        scans: Number of scans of all; None if it is unknown.
        duration: None, as they have no common clock.
    """

    name: str
    scans: int | None
    duration: None = None

    @classmethod
    def of(cls, sources: Sequence[Source]) -> Together:
        """Return the sum of these recordings."""
        counts = [source.scans for source in sources if source.scans is not None]
        return cls(", ".join(source.name for source in sources), sum(counts) if len(counts) == len(sources) else None)


class Progress:
    """Progress of a drive on standard error: scans, speed as a multiple of real time, and remaining time."""

    def __init__(self, source: Source | Together) -> None:
        self._source = source
        self._began = 0.0
        self._printed_at = 0.0
        self._count = 0
        self._terminal = sys.stderr.isatty()

    def begin(self) -> None:
        """Start the clock."""
        self._began = self._printed_at = time.monotonic()

    def update(self, count: int) -> None:
        """Record the number of scans so far, and print it from time to time."""
        self._count = count
        now = time.monotonic()
        if now - self._printed_at >= (TERMINAL_INTERVAL if self._terminal else LINE_INTERVAL):
            self._printed_at = now
            self._print("\r" if self._terminal else "", "" if self._terminal else "\n")

    def end(self) -> None:
        """Print the final state."""
        self._print("\r" if self._terminal else "", "\n")

    def _print(self, start: str, end: str) -> None:
        elapsed = max(time.monotonic() - self._began, 1e-9)
        text = f"{self._source.name}: {self._count} scans"
        total, duration = self._source.scans, self._source.duration
        if total:
            share = self._count / total
            text = f"{self._source.name}: {self._count}/{total} scans"
            if duration:
                text += f", {share * duration / elapsed:.1f} times real time"
            if 0 < share < 1:
                text += f", {elapsed / share - elapsed:.0f} s to go"
        print(f"{start}{text}, {elapsed:.1f} s", end=end.ljust(4) if start else end, file=sys.stderr, flush=True)
