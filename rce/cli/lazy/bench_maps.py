"""Implementation of `rce bench` for maps, paths and localisation."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

import msgspec

from rce.api.map_jobs import MAPPERS, MAX_PARALLEL
from rce.cli.arguments import DEV_USER
from rce.cli.lazy.bench_options import coroutine_command, numbers, parse_names
from rce.cli.platform import own_platform
from rce.cli.session import ConsoleSession
from rce.client import Robot
from rce.client.map_service import MapServiceClient
from rce.errors import InvalidRequest


@coroutine_command
async def measure_maps(args: argparse.Namespace) -> None:
    """Measure each mapper with each recording, or all recordings together with --workers."""
    if args.workers:
        await _measure_workers(args)
        return
    mappers = parse_names("mapper", args.mappers, MAPPERS)
    from rce.bench import maps, maps_report  # compile kernels

    odometry = parse_names("odometry", args.odometry, maps.ODOMETRIES)
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


async def _measure_workers(args: argparse.Namespace) -> None:
    """Measure the recordings as one job, with each number of workers."""
    from rce.bench import parallel_maps  # compiles kernels
    from rce.mapping.files.recordings import open_recording

    workers = numbers(args.workers, "--workers")
    if max(workers) > MAX_PARALLEL or args.cut < 1:
        raise InvalidRequest(f"rce bench: --workers are at most {MAX_PARALLEL}, and --cut is at least 1")
    recordings = [
        piece for path in args.recordings for piece in parallel_maps.cut(list(open_recording(path)), args.cut)
    ]
    with tempfile.TemporaryDirectory(prefix="rce-") as directory:
        async with (
            own_platform(Path(directory), args.engine) as entry,
            Robot(entry.url, user=DEV_USER, robot="bench", password=DEV_USER) as robot,
        ):
            result = await parallel_maps.measure(robot, recordings, workers)
    print(json.dumps(parallel_maps.as_data(result)) if args.json else parallel_maps.as_text(result))


@coroutine_command
async def measure_map_service(args: argparse.Namespace) -> None:
    """Measure the map service with a recording of several GB."""
    from rce.bench import large_recording as large  # compiles kernels

    result = await large.measure(args.dir, args.size * large.MEGABYTE, args.engine)
    print(json.dumps(large.as_data(result)) if args.json else large.as_text(result))


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


@coroutine_command
async def measure_endless(args: argparse.Namespace) -> None:
    """Measure each mapper over a long drive made of one recording."""
    mappers = parse_names("mapper", args.mappers, MAPPERS)
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
