"""`rce bench`: how fast a platform is."""

from __future__ import annotations

import argparse
import asyncio
import json
import secrets
import sys
import tempfile
from collections.abc import AsyncIterator, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rce import __version__
from rce.bench import overtake, payloads, report, start
from rce.bench.nodes import Place
from rce.bench.routes import ROUTES, USUAL
from rce.bench.run import take
from rce.client import Robot
from rce.client.map_service import MapService
from rce.commands.platform import DEV_USER, ENGINES, add_arguments, add_command, own_platform, platform, programs_log
from rce.errors import InvalidRequest
from rce.map_jobs import MAPPERS

if TYPE_CHECKING:
    from twisted.internet.base import ReactorBase

QUICK_SIZES, QUICK_SAMPLES = 4, 3


def parser() -> argparse.ArgumentParser:
    whole = argparse.ArgumentParser(prog="rce bench", description="Measure a platform.")
    kinds = whole.add_subparsers(dest="kind", required=True)
    rtt = add_command(kinds, "rtt", "round trips of messages of all sizes, beside those between two nodes")
    usual = ",".join(USUAL)
    rtt.add_argument("--routes", default=usual, help=f"comma list of {', '.join(ROUTES)} (default: {usual})")
    rtt.add_argument("--features", default="", help="route c2c2: two special features, each of one machine only")
    rtt.add_argument("--sizes", type=int, default=25, help="how many, from 10 B to 10 MB (default: %(default)s)")
    rtt.add_argument("--samples", type=int, default=20, help="of each size (default: %(default)s)")
    rtt.add_argument("--quick", action="store_true", help=f"{QUICK_SIZES} sizes, {QUICK_SAMPLES} samples")
    rtt.add_argument("--json", action="store_true", help="print every sample as JSON instead of a table")
    rtt.add_argument("--plot", type=Path, metavar="FILE", help="draw it, as .svg or .png")
    over = add_command(kinds, "overtake", "velocity commands of a robot that sends 10 MB images meanwhile")
    over.add_argument("--samples", type=int, default=300, help="(default: %(default)s)")
    over.add_argument("--json", action="store_true", help="print every sample as JSON instead of a table")
    begin = add_command(kinds, "start", "from the command to an environment that is ready, beside a bare container")
    begin.add_argument("--engines", default="process,docker", help="comma list (default: %(default)s)")
    begin.add_argument("--samples", type=int, default=10, help="of each (default: %(default)s)")
    begin.add_argument("--image", default=f"rce/mapping:{__version__}", help="of the bare one (default: %(default)s)")
    begin.add_argument("--json", action="store_true", help="print every sample as JSON instead of a table")
    maps = add_command(kinds, "map-service", "a large recording by the map service, and another user's job meanwhile")
    maps.add_argument("--size", type=int, default=4000, help="of the recording, MB (default: %(default)s)")
    maps.add_argument(
        "--dir", type=Path, default=Path(tempfile.gettempdir()), help="on which disk (default: %(default)s)"
    )
    maps.add_argument("--engine", choices=ENGINES, default="process", help="(default: %(default)s)")
    maps.add_argument("--json", action="store_true", help="print the figures as JSON")
    page = add_command(kinds, "dashboard", "dashboard and lists of a Master with many robots and environments")
    page.add_argument("--robots", type=int, default=200, help="with an environment each (default: %(default)s)")
    page.add_argument("--interfaces", type=int, default=5, help="of each of both (default: %(default)s)")
    page.add_argument("--seconds", type=float, default=20, help="for shares of a core (default: %(default)s)")
    page.add_argument("--samples", type=int, default=5, help="of loads and lists (default: %(default)s)")
    page.add_argument("--json", action="store_true", help="print every sample as JSON instead of a table")
    for each in (rtt, over):
        add_arguments(each)
    _add_maps(kinds)
    return whole


def _add_maps(kinds: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    recordings = add_command(
        kinds, "map", "recordings by the map service, what each mapper needs, and how good its maps are"
    )
    recordings.add_argument("--odometry", default="", help="comma list of recorded, noisy, worse, none")
    recordings.add_argument("--no-service", action="store_true", help="the mappers alone, without a platform")
    recordings.add_argument("--out", type=Path, metavar="DIR", help="for the maps")
    recordings.add_argument("--engine", choices=ENGINES, default="process", help="(default: %(default)s)")
    endless = add_command(kinds, "endless", "a recording forward, back, forward, …: memory, and time a scan")
    endless.add_argument("--scans", type=int, default=36_000, help="(default: %(default)s, an hour at 10 Hz)")
    for each in (recordings, endless):
        each.add_argument("recordings", nargs="+", type=Path, metavar="FILE", help="CARMEN log, ROS 1 or ROS 2 bag")
        each.add_argument("--mappers", default=",".join(MAPPERS), help="comma list (default: %(default)s)")
        each.add_argument("--json", action="store_true", help="print the figures as JSON")
        each.add_argument("--plot", type=Path, metavar="FILE", help="draw them, as .svg or .png")


def main(arguments: list[str]) -> int:
    words = parser().parse_args(arguments)
    if words.kind == "dashboard":
        return dashboard(words)
    asyncio.run(KINDS[words.kind](words))
    return 0


def dashboard(words: argparse.Namespace) -> int:
    """On the loop that Twisted shares, since it takes part as processes of the platform."""
    from rce import loop
    from rce.bench import dashboard as measured  # needs the extra `bench`
    from rce.bench.crowd import Size

    if min(words.robots, words.interfaces, words.samples) < 1:
        raise InvalidRequest("rce bench: --robots, --interfaces and --samples are 1 or more")
    program, size = measured.browser(), Size(words.robots, words.interfaces)

    async def run(reactor: ReactorBase) -> None:
        with programs_log() as log:
            result = await measured.measure(reactor, program, size, words.seconds, words.samples, log)
        print(json.dumps(measured.as_data(result)) if words.json else measured.as_text(result))

    return loop.run(run)


async def round_trips(words: argparse.Namespace) -> None:
    names = words.routes.split(",")
    unknown = set(names) - set(ROUTES)
    if unknown:
        raise InvalidRequest(f"rce bench: there is no route {', '.join(unknown)}: it is one of {', '.join(ROUTES)}")
    count, samples = (QUICK_SIZES, QUICK_SAMPLES) if words.quick else (words.sizes, words.samples)
    sizes = payloads.sizes(count)
    async with place(words) as where:
        probes = [probe for name in names for probe in await ROUTES[name](where)]
        series = await take(probes, sizes, samples, show)
    print(json.dumps(report.as_data(series)) if words.json else report.as_text(series))
    if words.plot is not None:
        from rce.bench.plot import plot  # needs the extra `bench`

        plot(series, words.plot)


async def overtaking(words: argparse.Namespace) -> None:
    async with place(words) as where:
        result = await overtake.measure(where, words.samples)
    print(json.dumps(overtake.as_data(result)) if words.json else overtake.as_text(result))


async def starting(words: argparse.Namespace) -> None:
    async with AsyncExitStack() as stack:
        robots: dict[str, Robot] = {}
        for engine in words.engines.split(","):
            if engine not in ENGINES:
                raise InvalidRequest(f"rce bench: there is no engine {engine}: it is one of {', '.join(ENGINES)}")
            access = await stack.enter_async_context(platform(argparse.Namespace(url="", engine=engine)))
            robot = Robot(access.url, user=access.user, robot="bench", password=access.password)
            robots[engine] = await stack.enter_async_context(robot)
        taken = await start.measure(robots, words.image, words.samples)
    print(json.dumps(start.as_data(taken)) if words.json else start.as_text(taken))


async def large_recording(words: argparse.Namespace) -> None:
    from rce.bench import large_recording as large  # compiles kernels

    result = await large.measure(words.dir, words.size * large.MEGABYTE, words.engine)
    print(json.dumps(large.as_data(result)) if words.json else large.as_text(result))


async def mapping(words: argparse.Namespace) -> None:
    mappers = chosen("mapper", words.mappers, MAPPERS)
    from rce.bench import maps, maps_report  # compile kernels

    odometry = chosen("odometry", words.odometry, maps.ODOMETRIES)
    recordings = [maps.look(path) for path in words.recordings]
    served = []
    if not words.no_service:
        with tempfile.TemporaryDirectory(prefix="rce-") as directory:
            async with own_platform(Path(directory), words.engine) as entry:
                service = MapService(entry.url, user=DEV_USER, password=DEV_USER)
                for each in recordings:
                    served += [await maps.serve(service, each, mapper) for mapper in mappers]
    results = maps.Results(recordings, served, list(maps.trials(recordings, mappers, odometry, words.out)))
    print(json.dumps(maps_report.as_data(results)) if words.json else maps_report.as_text(results))
    if words.plot is not None:
        from rce.bench.maps_plot import plot  # needs the extra `bench`

        plot(results, words.plot)


async def endless(words: argparse.Namespace) -> None:
    mappers = chosen("mapper", words.mappers, MAPPERS)
    from rce.bench import maps, maps_report  # compile kernels

    runs = {
        f"{path.name.partition('.')[0]}, {mapper}": maps.endless(path, mapper, words.scans)
        for path in words.recordings
        for mapper in mappers
    }
    print(json.dumps(maps_report.endless_data(runs)) if words.json else maps_report.endless_text(runs))
    if words.plot is not None:
        from rce.bench.maps_plot import plot_endless  # needs the extra `bench`

        plot_endless(runs, words.plot)


N = TypeVar("N", bound=str)


def chosen(what: str, words: str, known: Sequence[N]) -> list[N]:
    """A comma list of names that are known. InvalidRequest."""
    names = [name for name in known if name in words.split(",")]
    unknown = set(words.split(",")) - {"", *names}
    if unknown:
        raise InvalidRequest(f"rce bench: there is no {what} {', '.join(unknown)}: it is one of {', '.join(known)}")
    return names


KINDS = {
    "map-service": large_recording,
    "map": mapping,
    "endless": endless,
    "rtt": round_trips,
    "overtake": overtaking,
    "start": starting,
}


@asynccontextmanager
async def place(words: argparse.Namespace) -> AsyncIterator[Place]:
    """A robot with an environment of its own, both gone at the end."""
    name = f"bench_{secrets.token_hex(4)}"
    async with (
        platform(words) as access,
        Robot(access.url, user=access.user, robot=name, password=access.password, key=access.key) as robot,
        robot.environment(f"env_{name}", restart="no") as environment,
        AsyncExitStack() as stack,
    ):
        features = getattr(words, "features", "")
        yield Place(robot, environment, stack, features.split(",") if features else [])


def show(done: int, of: int) -> None:
    """Progress on standard error, where it is a terminal."""
    if sys.stderr.isatty():
        print(f"\r{done}/{of} sizes", end="\n" if done == of else "", file=sys.stderr, flush=True)
