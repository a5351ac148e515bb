"""Implementation of `rce bench` for the data path, starts and formats."""

from __future__ import annotations

import argparse
import json
import secrets
import sys
import tempfile
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

import msgspec

from rce.api.client import ApiClient
from rce.bench import channels, overtake, payloads, report, start
from rce.bench.nodes import Place
from rce.bench.routes import ROUTES
from rce.bench.run import take
from rce.cli.arguments import DEV_USER, ENGINES
from rce.cli.commands.bench import QUICK_SAMPLES, QUICK_SIZES
from rce.cli.lazy.bench_options import check_names, coroutine_command
from rce.cli.platform import own_platform, platform
from rce.cli.session import ConsoleSession
from rce.client import Robot
from rce.client.address import Address
from rce.errors import InvalidRequest


@coroutine_command
async def measure_round_trips(args: argparse.Namespace) -> None:
    """Measure round trips over the routes of --routes."""
    names = args.routes.split(",")
    check_names("route", names, ROUTES)
    count, samples = (QUICK_SIZES, QUICK_SAMPLES) if args.quick else (args.sizes, args.samples)
    sizes = payloads.sizes(count)
    async with _bench_place(args) as place:
        probes = [probe for name in names for probe in await ROUTES[name](place)]
        series = await take(probes, sizes, samples, _show_progress)
    print(json.dumps(report.as_data(series)) if args.json else report.as_text(series))
    if args.plot is not None:
        from rce.bench.plot import plot  # needs the extra `bench`

        plot(series, args.plot)


@coroutine_command
async def measure_overtake(args: argparse.Namespace) -> None:
    """Measure velocity commands that share a robot's connection with large images, or what a viewer receives."""
    async with _bench_place(args) as place:
        if args.foxglove:
            seen = await channels.measure(place, args.foxglove)
            data = channels.as_data(seen, args.foxglove)
            print(json.dumps(data) if args.json else channels.as_text(seen, args.foxglove))
            return
        result = await overtake.measure(place, args.samples)
    print(json.dumps(overtake.as_data(result)) if args.json else overtake.as_text(result))


@coroutine_command
async def measure_viewers(args: argparse.Namespace) -> None:
    """Measure a control loop beside many viewers of one camera."""
    from rce.bench import viewers  # needs the extra `bench`
    from rce.bench.viewer_program import Task

    try:
        rates = tuple(float(each) for each in args.rates.split(","))
    except ValueError:
        raise InvalidRequest("rce bench: --rates is a list of numbers such as 0,10") from None
    if min(args.viewers, args.samples) < 1:
        raise InvalidRequest("rce bench: --viewers and --samples must be at least 1")
    task = Task(args.viewers, rates, args.format, args.codec)
    async with _bench_place(args) as place:
        phases = await viewers.measure(place, task, args.samples)
    print(json.dumps(msgspec.to_builtins(phases)) if args.json else viewers.as_text(phases))


@coroutine_command
async def measure_delivery(args: argparse.Namespace) -> None:
    """Measure the bytes of messages by the options of an interface."""
    from rce.bench import delivery  # needs the extra `video`

    if args.messages < 1:
        raise InvalidRequest("rce bench: --messages must be at least 1")
    found = delivery.sources(args.recording, args.messages)
    async with _bench_place(args) as place:
        figures = await delivery.measure(place.robot, found)
    print(json.dumps(msgspec.to_builtins(figures)) if args.json else delivery.as_text(figures))


@coroutine_command
async def measure_start(args: argparse.Namespace) -> None:
    """Measure how long environments take to start, with each engine."""
    engines = args.engines.split(",")
    check_names("engine", engines, ENGINES)
    kinds = {engine: (engine, 0) for engine in engines}
    if "process" in engines:
        kinds[start.WARM] = ("process", 2)
    async with AsyncExitStack() as stack:
        robots: dict[str, Robot] = {}
        for name, (engine, warm) in kinds.items():
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="rce-")))
            entry = await stack.enter_async_context(own_platform(directory, engine, warm=warm))
            start.publish(ApiClient(entry.url, user=DEV_USER, password=DEV_USER))
            robot = Robot(entry.url, user=DEV_USER, robot="bench", password=DEV_USER)
            robots[name] = await stack.enter_async_context(robot)
        result = await start.measure(robots, args.image, args.samples)
    print(json.dumps(start.as_data(result)) if args.json else start.as_text(result))


def measure_video(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Measure the video formats."""
    from rce.bench import video  # needs the extra `video`

    if args.images < 1:
        raise InvalidRequest("rce bench: --images must be at least 1")
    figures = list(video.measure(*video.read(args.recording, args.images)))
    print(json.dumps(msgspec.to_builtins(figures)) if args.json else video.as_text(figures))


@coroutine_command
async def measure_bags(args: argparse.Namespace) -> None:
    """Measure recording, and then playing in an environment."""
    from rce.bench import bags  # needs the extras `bag` and `bench`

    with tempfile.TemporaryDirectory(dir=args.directory) as name:
        directory = Path(name)
        recorded = await bags.record(directory / "bench.mcap", args.rate * 1e6, args.seconds)
        async with _bench_place(args) as place:
            played = await bags.replay(place, directory, args.seconds)
    print(json.dumps(bags.as_data(recorded, played)) if args.json else bags.as_text(recorded, played))


@coroutine_command
async def measure_knowledge(args: argparse.Namespace) -> None:
    """Measure searches of the knowledge repository."""
    if min(args.entries, args.samples) < 1:
        raise InvalidRequest("rce bench: --entries and --samples must be at least 1")
    from rce.bench import knowledge  # needs the extra `knowledge`

    figures = await knowledge.measure(args.entries, args.samples)
    print(json.dumps(msgspec.to_builtins(figures)) if args.json else knowledge.table(figures, args.entries))


@asynccontextmanager
async def _bench_place(args: argparse.Namespace) -> AsyncIterator[Place]:
    """Create a robot and an environment for the measurement, and remove both afterwards."""
    name = f"bench_{secrets.token_hex(4)}"
    async with (
        platform(args) as access,
        Robot(access.url, user=access.user, robot=name, password=access.password, key=access.key) as robot,
        robot.environment(f"env_{name}", restart="no") as environment,
        AsyncExitStack() as stack,
    ):
        features = getattr(args, "features", "")
        address = Address(access.url, access.user, "", access.password, access.key)
        yield Place(robot, environment, stack, features.split(",") if features else [], address)


def _show_progress(done: int, total: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{done}/{total} sizes", end="\n" if done == total else "", file=sys.stderr, flush=True)
