"""Implementation of `rce bench`."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import secrets
import shutil
import sys
import tempfile
from collections.abc import AsyncIterator, Callable, Collection, Coroutine, Iterable, Iterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from rce.api.client import ApiClient
from rce.api.map_jobs import MAPPERS
from rce.bench import channels, overtake, payloads, report, start, viewers
from rce.bench.nodes import Place
from rce.bench.routes import ROUTES
from rce.bench.run import take
from rce.bench.viewer_program import Task
from rce.cli.arguments import DEV_USER, ENGINES
from rce.cli.commands.bench import QUICK_SAMPLES, QUICK_SIZES
from rce.cli.platform import own_platform, platform, programs_log
from rce.cli.session import ConsoleSession
from rce.client import Robot
from rce.client.address import Address
from rce.client.map_service import MapServiceClient
from rce.errors import InvalidRequest

if TYPE_CHECKING:
    from twisted.internet.base import ReactorBase

N = TypeVar("N", bound=str)


def _command(
    function: Callable[[argparse.Namespace], Coroutine[Any, Any, None]],
) -> Callable[[ConsoleSession, argparse.Namespace], None]:
    """Return the function of a command that runs a coroutine."""

    @wraps(function)
    def run(session: ConsoleSession, args: argparse.Namespace) -> None:
        asyncio.run(function(args))

    return run


def measure_dashboard(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Measure the dashboard, on Twisted's event loop because the bench stands in for processes of the platform."""
    from rce.bench import dashboard as measured  # needs the extra `bench`
    from rce.bench.crowd import Size
    from rce.process import loop

    if min(args.robots, args.interfaces, args.samples) < 1:
        raise InvalidRequest("rce bench: --robots, --interfaces and --samples must be at least 1")
    program, size = measured.browser(), Size(args.robots, args.interfaces)

    async def run(reactor: ReactorBase) -> None:
        with programs_log() as log:
            result = await measured.measure(reactor, program, size, args.seconds, args.samples, log)
        print(json.dumps(measured.as_data(result)) if args.json else measured.as_text(result))

    return loop.run(run)


@_command
async def measure_round_trips(args: argparse.Namespace) -> None:
    """Measure round trips over the routes of --routes."""
    names = args.routes.split(",")
    _check_names("route", names, ROUTES)
    count, samples = (QUICK_SIZES, QUICK_SAMPLES) if args.quick else (args.sizes, args.samples)
    sizes = payloads.sizes(count)
    async with _bench_place(args) as place:
        probes = [probe for name in names for probe in await ROUTES[name](place)]
        series = await take(probes, sizes, samples, _show_progress)
    print(json.dumps(report.as_data(series)) if args.json else report.as_text(series))
    if args.plot is not None:
        from rce.bench.plot import plot  # needs the extra `bench`

        plot(series, args.plot)


@_command
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


@_command
async def measure_viewers(args: argparse.Namespace) -> None:
    """Measure a control loop beside many viewers of one camera."""
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


@_command
async def measure_delivery(args: argparse.Namespace) -> None:
    """Measure the bytes of messages by the options of an interface."""
    from rce.bench import delivery  # needs the extra `video`

    if args.messages < 1:
        raise InvalidRequest("rce bench: --messages must be at least 1")
    found = delivery.sources(args.recording, args.messages)
    async with _bench_place(args) as place:
        figures = await delivery.measure(place.robot, found)
    print(json.dumps(msgspec.to_builtins(figures)) if args.json else delivery.as_text(figures))


@_command
async def measure_start(args: argparse.Namespace) -> None:
    """Measure how long environments take to start, with each engine."""
    engines = args.engines.split(",")
    _check_names("engine", engines, ENGINES)
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


def measure_control(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Measure commands and logins, on Twisted's event loop because of the bare calls beside them."""
    from rce.bench import control  # needs the extra `server`
    from rce.bench.crowd import create_key
    from rce.process import loop

    crowds = [int(each) if each.isdecimal() else 0 for each in args.robots.split(",")]
    if min(*crowds, args.count) < 1:
        raise InvalidRequest("rce bench: --robots is a list of numbers such as 1,20, and --count at least 1")

    async def run(reactor: ReactorBase) -> None:
        with tempfile.TemporaryDirectory(prefix="rce-") as directory:
            async with own_platform(Path(directory), args.engine, size=max(crowds)) as entry:
                key = await asyncio.to_thread(create_key, entry.url)
                credentials = control.Credentials(entry.url, DEV_USER, DEV_USER, key)
                phases = await control.measure(credentials, crowds, args.count)
            phases += await control.floors(reactor, Path(directory))
        print(json.dumps(control.as_data(phases)) if args.json else control.as_text(phases))

    return loop.run(run)


def measure_traffic(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Measure crowds of robots, and a flood; each number of processes has a platform of its own."""
    import uvloop

    from rce.bench.crowd import create_key  # needs the extra `server`
    from rce.bench.traffic import crowd, flood, login, report

    robots, processes = _numbers(args.robots, "--robots"), _numbers(args.processes, "--processes")
    if args.size < crowd.STAMP or args.flood < flood.NUMBER or min(args.rate, args.seconds) <= 0:
        raise InvalidRequest(
            f"rce bench: --size is at least {crowd.STAMP}, --flood {flood.NUMBER}, --rate and --seconds are above 0"
        )

    async def run() -> None:
        crowds, floods = [], []
        for count in processes:
            with tempfile.TemporaryDirectory(prefix="rce-") as name:
                async with own_platform(Path(name), "process", robot_processes=count) as entry:
                    key = await asyncio.to_thread(create_key, entry.url)
                    access = login.Login(entry.url, DEV_USER, key)
                    await crowd.until_joined(entry.url, count)
                    for number in robots:
                        load = crowd.Load(number, args.rate, args.size, args.seconds)
                        crowds.append(await crowd.crowd(access, Path(name), load, count))
                    if count == processes[0]:
                        floods.append(await flood.flood(access, args.flood, args.seconds))
        print(json.dumps(report.as_data(crowds, floods)) if args.json else report.as_text(crowds, floods))

    uvloop.run(run())


def _numbers(text: str, option: str) -> list[int]:
    """Return a list of numbers that was given as `1,20`."""
    numbers = [int(each) if each.isdecimal() else 0 for each in text.split(",")]
    if min(numbers) < 1:
        raise InvalidRequest(f"rce bench: {option} is a list of numbers such as 1,20")
    return numbers


def measure_fleet(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Measure a fleet, on Twisted's event loop because the bench stands in for processes of the platform."""
    from rce.bench import fleet  # needs the extras `server` and `bench`
    from rce.process import loop

    size = fleet.Size(args.machines, args.robots)
    if not 1 <= size.machines <= size.robots:
        raise InvalidRequest("rce bench: there is at least one machine, and at least as many robots as machines")

    async def run(reactor: ReactorBase) -> None:
        def report(name: str) -> None:
            print(name, file=sys.stderr, flush=True)

        with tempfile.TemporaryDirectory(prefix="rce-") as directory, programs_log() as log:
            phases = await fleet.measure(reactor, Path(directory), size, log, report)
        print(json.dumps(fleet.as_data(size, phases)) if args.json else fleet.as_text(size, phases))

    return loop.run(run)


@_command
async def measure_network(args: argparse.Namespace) -> None:
    """Measure a robot behind bad networks."""
    from rce.bench.network import line, robot, run  # need the extra `server`
    from rce.bench.network import report as network_report

    profiles = _parse_names("profile", args.profiles, list(line.PROFILES))
    modes = _parse_names("mode", args.modes, robot.MODES)
    if args.seconds <= 0:
        raise InvalidRequest("rce bench: --seconds must be positive")
    results = []
    with programs_log() as log:
        for profile in profiles:
            for mode in modes:
                with tempfile.TemporaryDirectory(prefix="rce-") as directory:
                    results.append(await run.measure(profile, mode, args.seconds, Path(directory), log))
    print(json.dumps(network_report.as_data(results)) if args.json else network_report.as_text(results))


@_command
async def measure_soak(args: argparse.Namespace) -> None:
    """Measure the growth of all processes while robots come and go."""
    from rce.bench import soak  # needs the extra `bench`

    if min(args.minutes, args.rate) <= 0:
        raise InvalidRequest("rce bench: --minutes and --rate must be positive")

    def show(result: soak.Result) -> None:
        print(soak.as_text(result), end="\n\n", file=sys.stderr, flush=True)

    with tempfile.TemporaryDirectory(prefix="rce-") as directory:
        async with own_platform(Path(directory), args.engine) as entry:
            result = await soak.measure(entry.url, DEV_USER, Path(directory), args.minutes, args.rate, show)
    print(json.dumps(soak.as_data(result)) if args.json else soak.as_text(result))


@_command
async def measure_chaos(args: argparse.Namespace) -> None:
    """Let processes of a platform fail, and check what it has acknowledged."""
    from rce.bench.chaos import report as chaos_report
    from rce.bench.chaos.run import Plan, measure  # needs the extra `server`

    with _run_directory(args) as directory:
        result = await measure(directory, Plan(_seed(args), args.events, 60 * args.minutes), _show_faults)
    print(json.dumps(chaos_report.as_data(result)) if args.json else chaos_report.as_text(result))


@_command
async def measure_standby(args: argparse.Namespace) -> None:
    """Let the leader of two Masters fail, and check what they have acknowledged."""
    from rce.bench.standby import report as standby_report
    from rce.bench.standby.run import Plan, measure  # needs the extras `server` and `postgresql`

    with _run_directory(args) as directory:
        result = await measure(directory, Plan(_seed(args), args.events, 60 * args.minutes), _show_faults)
    print(json.dumps(standby_report.as_data(result)) if args.json else standby_report.as_text(result))


def _seed(args: argparse.Namespace) -> int:
    return secrets.randbelow(1_000_000) if args.seed is None else int(args.seed)


@contextlib.contextmanager
def _run_directory(args: argparse.Namespace) -> Iterator[Path]:
    """Give the directory of a run with faults; a temporary one remains after a failure, which names its files."""
    if args.minutes <= 0 or args.events < 1:
        raise InvalidRequest("rce bench: --minutes and --events must be positive")
    directory = args.dir or Path(tempfile.mkdtemp(prefix="rce-bench-"))
    directory.mkdir(parents=True, exist_ok=True)
    yield directory
    if args.dir is None:
        shutil.rmtree(directory)


@_command
async def measure_map_service(args: argparse.Namespace) -> None:
    """Measure the map service with a recording of several GB."""
    from rce.bench import large_recording as large  # compiles kernels

    result = await large.measure(args.dir, args.size * large.MEGABYTE, args.engine)
    print(json.dumps(large.as_data(result)) if args.json else large.as_text(result))


@_command
async def measure_maps(args: argparse.Namespace) -> None:
    """Measure each mapper with each recording."""
    mappers = _parse_names("mapper", args.mappers, MAPPERS)
    from rce.bench import maps, maps_report  # compile kernels

    odometry = _parse_names("odometry", args.odometry, maps.ODOMETRIES)
    recordings = [maps.inspect_recording(path) for path in args.recordings]
    served = []
    if not args.no_service:
        with tempfile.TemporaryDirectory(prefix="rce-") as directory:
            async with own_platform(Path(directory), args.engine) as entry:
                service = MapServiceClient(entry.url, user=DEV_USER, password=DEV_USER)
                for each in recordings:
                    served += [await maps.serve(service, each, mapper) for mapper in mappers]
    results = maps.Results(recordings, served, list(maps.trials(recordings, mappers, odometry, args.out)))
    print(json.dumps(maps_report.as_data(results)) if args.json else maps_report.as_text(results))
    if args.plot is not None:
        from rce.bench.maps_plot import plot  # needs the extra `bench`

        plot(results, args.plot)


def measure_video(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Measure the video formats."""
    from rce.bench import video  # needs the extra `video`

    if args.images < 1:
        raise InvalidRequest("rce bench: --images must be at least 1")
    figures = list(video.measure(*video.read(args.recording, args.images)))
    print(json.dumps(msgspec.to_builtins(figures)) if args.json else video.as_text(figures))


def measure_planners(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Measure the planners."""
    from rce.bench import planning  # compiles kernels

    if args.samples < 1:
        raise InvalidRequest("rce bench: --samples must be at least 1")
    figures = [figure for case in planning.cases(args.maps) for figure in planning.measure(case, args.samples)]
    print(json.dumps(msgspec.to_builtins(figures)) if args.json else planning.table(figures))


def measure_localisation(session: ConsoleSession, args: argparse.Namespace) -> None:
    """Measure global localisation."""
    from rce.bench import localisation  # compiles kernels

    if min(args.parts, args.scans) < 1:
        raise InvalidRequest("rce bench: --parts and --scans must be at least 1")
    figures = localisation.measure(args.recording, args.parts, args.scans)
    print(json.dumps(msgspec.to_builtins(figures)) if args.json else localisation.table(figures))


@_command
async def measure_bags(args: argparse.Namespace) -> None:
    """Measure recording, and then playing in an environment."""
    from rce.bench import bags  # needs the extras `bag` and `bench`

    with tempfile.TemporaryDirectory(dir=args.directory) as name:
        directory = Path(name)
        recorded = await bags.record(directory / "bench.mcap", args.rate * 1e6, args.seconds)
        async with _bench_place(args) as place:
            played = await bags.replay(place, directory, args.seconds)
    print(json.dumps(bags.as_data(recorded, played)) if args.json else bags.as_text(recorded, played))


@_command
async def measure_knowledge(args: argparse.Namespace) -> None:
    """Measure searches of the knowledge repository."""
    if min(args.entries, args.samples) < 1:
        raise InvalidRequest("rce bench: --entries and --samples must be at least 1")
    from rce.bench import knowledge  # needs the extra `knowledge`

    figures = await knowledge.measure(args.entries, args.samples)
    print(json.dumps(msgspec.to_builtins(figures)) if args.json else knowledge.table(figures, args.entries))


@_command
async def measure_endless(args: argparse.Namespace) -> None:
    """Measure each mapper over a long drive made of one recording."""
    mappers = _parse_names("mapper", args.mappers, MAPPERS)
    from rce.bench import maps, maps_report  # compile kernels

    runs = {
        f"{path.name.partition('.')[0]}, {mapper}": maps.endless(path, mapper, args.scans)
        for path in args.recordings
        for mapper in mappers
    }
    print(json.dumps(maps_report.endless_data(runs)) if args.json else maps_report.endless_text(runs))
    if args.plot is not None:
        from rce.bench.maps_plot import plot_endless  # needs the extra `bench`

        plot_endless(runs, args.plot)


def _parse_names(kind: str, text: str, known: Sequence[N]) -> list[N]:
    """Return the known names in a comma-separated list.

    Raises:
        InvalidRequest: The list has another name.
    """
    given = text.split(",")
    _check_names(kind, filter(None, given), known)
    return [name for name in known if name in given]


def _check_names(kind: str, names: Iterable[str], known: Collection[str]) -> None:
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InvalidRequest(f"rce bench: there is no {kind} {', '.join(unknown)}: it is one of {', '.join(known)}")


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


def _show_faults(faults: int, commands: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{faults} faults, {commands} commands", end="", file=sys.stderr, flush=True)


def _show_progress(done: int, total: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{done}/{total} sizes", end="\n" if done == total else "", file=sys.stderr, flush=True)
