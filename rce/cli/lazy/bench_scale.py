"""Implementation of `rce bench` for many robots, long runs, bad networks and failures."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import secrets
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from rce.cli.arguments import DEV_USER
from rce.cli.platform import own_platform, programs_log
from rce.cli.session import ConsoleSession
from rce.errors import InvalidRequest

if TYPE_CHECKING:
    from twisted.internet.base import ReactorBase

from rce.cli.lazy.bench_options import coroutine_command, numbers, parse_names


def measure_control(session: ConsoleSession, args: argparse.Namespace) -> int:
    """Measure commands and logins, on Twisted's event loop because of the bare calls beside them."""
    from rce.bench import control  # needs the extra `server`
    from rce.bench.crowd import create_key
    from rce.process import loop

    crowds = numbers(args.robots, "--robots")
    if args.count < 1:
        raise InvalidRequest("rce bench: --count must be at least 1")

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

    robots, processes = numbers(args.robots, "--robots"), numbers(args.processes, "--processes")
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

    return loop.run(run, quiet=True)  # thousands of hollow processes log each attempt to connect


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


@coroutine_command
async def measure_network(args: argparse.Namespace) -> None:
    """Measure a robot behind bad networks."""
    from rce.bench.network import line, robot, run  # need the extra `server`
    from rce.bench.network import report as network_report

    profiles = parse_names("profile", args.profiles, list(line.PROFILES))
    modes = parse_names("mode", args.modes, robot.MODES)
    if args.seconds <= 0:
        raise InvalidRequest("rce bench: --seconds must be positive")
    results = []
    with programs_log() as log:
        for profile in profiles:
            for mode in modes:
                with tempfile.TemporaryDirectory(prefix="rce-") as directory:
                    results.append(await run.measure(profile, mode, args.seconds, Path(directory), log))
    print(json.dumps(network_report.as_data(results)) if args.json else network_report.as_text(results))


@coroutine_command
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


@coroutine_command
async def measure_chaos(args: argparse.Namespace) -> None:
    """Let processes of a platform fail, and check what it has acknowledged."""
    from rce.bench.chaos import report as chaos_report
    from rce.bench.chaos.run import Plan, measure  # needs the extra `server`

    with _run_directory(args) as directory:
        result = await measure(directory, Plan(_seed(args), args.events, 60 * args.minutes), _show_faults)
    print(json.dumps(chaos_report.as_data(result)) if args.json else chaos_report.as_text(result))


@coroutine_command
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


def _show_faults(faults: int, commands: int) -> None:
    if sys.stderr.isatty():
        print(f"\r{faults} faults, {commands} commands", end="", file=sys.stderr, flush=True)
