"""Benchmark of a Master with a whole fleet: what it costs to build it, to keep it, and to lose parts of it.

The Master and its database are real, all other processes are hollow (`rce.bench.hollow_fleet`). All robots belong to
one user. Throughout, a probe gives one command after the other, as a robot would.
"""

from __future__ import annotations

import asyncio
import resource
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import psutil
from msgspec import Struct, field, to_builtins
from twisted.internet.base import ReactorBase

from rce.api.client import ApiClient
from rce.bench.crowd import SIDES, TYPE, USER, create_key
from rce.bench.hollow_fleet import HollowFleet, as_setting, make_tokens
from rce.bench.report import MILLI, aligned, machine
from rce.bench.statistics import percentile
from rce.errors import RceError
from rce.process.garbage import collect_seldom
from rce.process.supervisor import ManagedProcess
from rce.protocol import messages as m

MAX_CONCURRENT = 50  # commands at a time
INTERFACES = 5  # of each robot and of each environment
CONNECTIONS = 2  # of each robot
IDLE = 30.0  # seconds
PROBE_INTERVAL = 0.05  # seconds between two commands of the probe
LOST = 10  # one machine in so many dies
MACHINE_GRACE = 30  # seconds until the environments of a lost machine are placed on others
PATIENCE = 900.0  # seconds for a phase
MEGABYTE = 1e6


class Size(NamedTuple):
    """Size of a fleet; each robot has an environment."""

    machines: int
    robots: int

    @property
    def processes(self) -> int:
        """Number of control connections: a task set and a Robot endpoint for each machine, and all environments."""
        return 2 * self.machines + self.robots


class Phase(Struct):
    """One phase of the benchmark.

    Attributes:
        name: What was done.
        number: How many of that.
        seconds: Duration.
        processor: Seconds of processor time of the Master.
        memory: Resident memory of the Master at the end, in bytes.
        probes: Seconds of each command of the probe meanwhile.
        failed: Commands of the probe that failed.
    """

    name: str
    number: int
    seconds: float = 0.0
    processor: float = 0.0
    memory: int = 0
    probes: list[float] = field(default_factory=list)
    failed: int = 0


class Bench:
    """Measurement of one Master with its fleet."""

    def __init__(self, master: ManagedProcess, fleet: HollowFleet, size: Size, key: str, report: Callable[[str], None]):
        """Prepare the measurement; `report` gets the name of each phase when it begins."""
        self.phases: list[Phase] = []
        self._master = master
        self._fleet = fleet
        self._size = size
        self._key = key
        self._report = report

    async def run(self) -> list[Phase]:
        """Run all phases; return their results."""
        size, fleet = self._size, self._fleet
        robots, tags = range(size.robots), range(INTERFACES)
        async with self._phase("task sets and Robot endpoints join", 2 * size.machines):
            fleet.add_machines(size.machines, size.robots + 1)
            await self._until_joined(2 * size.machines)
        await fleet.login(USER, 0, self._key)
        await self._execute(0, m.CreateContainer("brain0"))
        probing = asyncio.create_task(self._probe())
        try:
            await self._all("robots log in", (fleet.login(USER, n, self._key) for n in robots[1:]))
            await self._commands("environments", ((n, m.CreateContainer(f"brain{n}")) for n in robots[1:]))
            await self._commands(
                "interfaces",
                (
                    (n, m.AddInterface(f"{'r' if side == 'robot' else side}{n}", f"i{tag}", kind, TYPE, f"/t{tag}"))
                    for n in robots
                    for side, kind in SIDES
                    for tag in tags
                ),
            )
            ends = ((n, m.Connect(f"r{n}/i{tag}", f"brain{n}/i{tag}")) for n in robots for tag in tags[:CONNECTIONS])
            await self._commands("connections", ends)
            async with self._phase(f"idle for {IDLE:g} s", size.processes):
                await asyncio.sleep(IDLE)
            await self._lists()
            await self._lose_machines()
            await self._restart()
        finally:
            probing.cancel()
        return self.phases

    async def _lists(self) -> None:
        """Read all robots and environments by pages, as the console and the dashboard do."""
        api = ApiClient(self._url, user=USER, password=USER)
        for name in ("robots", "environments"):
            async with self._phase(f"list of all {name}", self._size.robots):
                await asyncio.to_thread(list, api.items(dict[str, Any], name))

    async def _lose_machines(self) -> None:
        """Let one machine in LOST die; wait until their environments run on others."""
        dying = self._fleet.machines[1::LOST]  # not the first one, where the probe is
        lost = sum(len(each.environments) for each in dying)
        async with self._phase("environments of dead machines run again", lost):
            joined = self._fleet.joins
            await asyncio.gather(*(each.die() for each in dying))
            await self._until_joined(joined + lost)
        for each in dying:
            self._fleet.machines.remove(each)

    async def _restart(self) -> None:
        """Kill the Master; wait until all processes have joined the next one."""
        connected = 2 * len(self._fleet.machines) + self._size.robots
        async with self._phase("processes join after a restart of the Master", connected):
            joined = self._fleet.joins
            psutil.Process(self._master.pid).kill()
            await self._until_joined(joined + connected)

    # --- phases -------------------------------------------------------------------------------------------------------

    @asynccontextmanager
    async def _phase(self, name: str, number: int) -> AsyncIterator[None]:
        self._report(f"{name} ({number})")
        phase = Phase(name, number)
        self.phases.append(phase)
        pid, before, began = self._master.pid, self._processor(), time.perf_counter()
        async with asyncio.timeout(PATIENCE):
            yield
        phase.seconds = time.perf_counter() - began
        phase.processor = self._processor() - (before if self._master.pid == pid else 0.0)
        phase.memory = psutil.Process(self._master.pid).memory_info().rss

    def _processor(self) -> float:
        times = psutil.Process(self._master.pid).cpu_times()
        return times.user + times.system

    async def _commands(self, name: str, commands: Iterable[tuple[int, m.Command]]) -> None:
        await self._all(name, (self._execute(number, command) for number, command in commands))

    async def _execute(self, number: int, command: m.Command) -> None:
        await self._fleet.execute(USER, number, command)

    async def _all(self, name: str, work: Iterable[Awaitable[Any]]) -> None:
        """Measure works, MAX_CONCURRENT at a time."""
        waiting = list(work)
        async with self._phase(name, len(waiting)):
            gate = asyncio.Semaphore(MAX_CONCURRENT)

            async def one(each: Awaitable[Any]) -> None:
                async with gate:
                    await each

            await asyncio.gather(*map(one, waiting))

    async def _until_joined(self, count: int) -> None:
        while self._fleet.joins < count:  # noqa: ASYNC110  # there is no event for a number
            await asyncio.sleep(0.05)

    async def _probe(self) -> None:
        """Set a parameter again and again; note how long each takes."""
        for number in range(10**9):
            phase, began = self.phases[-1], time.perf_counter()
            try:
                await self._execute(0, m.SetParameter("brain0", "probe", number))
            except RceError:
                phase.failed += 1
            else:
                phase.probes.append(time.perf_counter() - began)
            await asyncio.sleep(PROBE_INTERVAL)

    @property
    def _url(self) -> str:
        assert self._master.ready is not None
        return self._master.ready.url


async def measure(
    reactor: ReactorBase, directory: Path, size: Size, log: IO[str], report: Callable[[str], None]
) -> list[Phase]:
    """Measure a fleet with a Master of its own.

    Args:
        reactor: Twisted's reactor.
        directory: Directory for the data.
        size: Size of the fleet.
        log: File for the Master's log.
        report: Called with the name of each phase when it begins.

    Raises:
        StartFailed: The Master did not start.
    """
    # A full collection stops all hollow processes for more than a second.
    collect_seldom(asyncio.get_running_loop().call_later)
    _raise_descriptor_limit()
    tokens = make_tokens(size.machines)
    ports = {"http": 0, "control": 0}  # of the first start; a restart uses the same

    def arguments() -> list[str]:
        listeners = [f"--{name}=tcp:{port}:interface=127.0.0.1" for name, port in ports.items()]
        return ["--dev", f"--data-dir={directory / 'master'}", f"--machine-grace={MACHINE_GRACE}", *listeners]

    master = ManagedProcess("master", arguments, {"RCE_TOKENS": as_setting(tokens)}, log)
    try:
        ready = await master.start()
        ports = {"http": _port(ready.url), "control": _port(ready.control)}
        fleet = HollowFleet(reactor, ready.control, tokens)
        try:
            key = await asyncio.to_thread(create_key, ready.url)
            return await Bench(master, fleet, size, key, report).run()
        finally:
            await fleet.stop()
    finally:
        await master.stop()


def _port(address: str) -> int:
    """Return the port of a URL or a client endpoint."""
    return int(address.rstrip("/").rpartition(":")[2])


def _raise_descriptor_limit() -> None:
    """Allow as many open files as the system lets this process have; the Master inherits the limit."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def as_text(size: Size, phases: list[Phase]) -> str:
    """Return a table of the phases."""
    host = machine()
    title = (
        f"Master with {size.machines} machines, {size.robots} robots, each with an environment, {INTERFACES} "
        f"interfaces at both and {CONNECTIONS} connections; {host['processor']}, {host['cores']} cores, "
        f"load {host['load']:.1f}"
    )
    head = [
        "",
        "number",
        "seconds",
        "Master ms each",
        "Master cores",
        "Master MB",
        "command p50 ms",
        "p99 ms",
        "failed",
    ]
    rows = [head, *map(_row, phases)]
    rows = [[row[0].ljust(max(len(each[0]) for each in rows)), *row[1:]] for row in rows]
    return "\n".join([title, "", *aligned(rows)])


def _row(phase: Phase) -> list[str]:
    probes = [f"{percentile(phase.probes, p) * MILLI:.1f}" if phase.probes else "-" for p in (50, 99)]
    return [
        phase.name,
        str(phase.number),
        f"{phase.seconds:.1f}",
        f"{phase.processor / max(1, phase.number) * MILLI:.2f}",
        f"{phase.processor / phase.seconds:.2f}",
        f"{phase.memory / MEGABYTE:.0f}",
        *probes,
        str(phase.failed),
    ]


def as_data(size: Size, phases: list[Phase]) -> dict[str, Any]:
    """Return all figures in seconds and bytes, for JSON."""
    return {"machine": machine(), "size": size._asdict(), "phases": to_builtins(phases)}
