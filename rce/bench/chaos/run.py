"""A run: robots give commands and send messages, processes fail, and the platform is compared with the model."""

from __future__ import annotations

import asyncio
import random
import time
from collections import Counter, defaultdict
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rce.bench.chaos import audit, faults
from rce.bench.chaos.flows import Flow, between, through_node
from rce.bench.chaos.history import History
from rce.bench.chaos.model import Model, Step
from rce.bench.chaos.platform import ENDPOINTS, MAPS, TASK_SET, Platform, running
from rce.bench.chaos.report import Result
from rce.bench.chaos.violations import Violation, violation
from rce.bench.chaos.workload import FAULTS, RETRY_INTERVAL, RobotWorker, UploadWorker, Worker
from rce.client import Robot
from rce.errors import NotFound, RceError
from rce.protocol.messages import DropEvent

ROBOTS = 3
TWO_AT_ONCE = 0.2  # share of faults during which another one happens
AUDIT_EVERY = 10  # faults
PAUSE = 0.0, 0.5  # seconds between a recovery and the next fault
PROBE = "probe"
PATIENCE = 2.0  # seconds for which uploads are repeated by the client itself, so that refusals are seen


class Plan(NamedTuple):
    """Extent of a run, which ends when one of the bounds is reached.

    Attributes:
        seed: Seed of all random choices.
        events: Maximum number of faults.
        seconds: Maximum duration.
        long: Some processes are stopped for so long that the Master regards them as lost.
    """

    seed: int
    events: int
    seconds: float
    long: bool = True


class Robots(NamedTuple):
    """Robots at work: their flows, and by environment the flow through it."""

    robots: Sequence[Robot]
    flows: list[Flow]
    through: dict[str, Flow]


async def measure(directory: Path, plan: Plan, progress: Callable[[int, int], None] = lambda *_: None) -> Result:
    """Run a platform in a directory and let it fail.

    Args:
        directory: Empty directory; `history.jsonl` and `log` remain in it.
        plan: Extent of the run.
        progress: Called with the number of faults and with the number of acknowledged commands.

    Raises:
        Violation: The platform did not keep a promise, or did not start; the message has the seed and the ends of
            history and logs.
    """
    history = History(directory / "history.jsonl")
    try:
        async with running(directory) as platform:
            return await Run(platform, plan, history, progress).measure()
    except* (RceError, AssertionError) as errors:
        raise violation(errors, plan.seed, directory, history) from None
    finally:
        history.close()


class Run:
    """One run on a running platform."""

    def __init__(self, platform: Platform, plan: Plan, history: History, progress: Callable[[int, int], None]) -> None:
        """Prepare the run."""
        self._platform = platform
        self._plan = plan
        self._history = history
        self._progress = progress
        self._model = Model()
        self._random = random.Random(plan.seed)
        self._workers: list[Worker] = []
        self._events: Counter[str] = Counter()
        self._recoveries: dict[str, list[float]] = defaultdict(list)
        self._audits: list[float] = []
        self._probes = 0

    async def measure(self) -> Result:
        """Run until a bound of the plan is reached, and compare at the end.

        Raises:
            Violation: The platform did not keep a promise.
        """
        began = time.monotonic()
        maps = self._platform.maps(PATIENCE)
        with_files = self._platform.directory / "recordings"
        with_files.mkdir()
        async with self._robots() as robots, asyncio.TaskGroup() as tasks:
            self._model = Model((await asyncio.to_thread(audit.look, self._platform)).facts)
            self._workers = [RobotWorker(each, self._model, self._history, self._plan.seed) for each in robots.robots]
            self._workers.append(UploadWorker(maps, with_files, self._model, self._history, self._plan.seed))
            working = [tasks.create_task(worker.run()) for worker in self._workers]
            working += [tasks.create_task(_watch_drops(robot, robots.flows)) for robot in robots.robots]
            await self._fail(robots, began + self._plan.seconds)
            for flow in robots.flows:
                await flow.end()
            for task in working:
                task.cancel()
            counts = [flow.count() for flow in robots.flows]
        refused = sum((worker.refused for worker in self._workers), Counter[str]())
        return Result(
            self._plan.seed,
            time.monotonic() - began,
            dict(self._events),
            self._model.acknowledged,
            dict(refused),
            self._audits,
            dict(self._recoveries),
            counts,
            bool(self._platform.disks),
        )

    @asynccontextmanager
    async def _robots(self) -> AsyncIterator[Robots]:
        """Connect the robots, each with an environment, and begin their flows."""
        async with AsyncExitStack() as stack:
            robots = [await stack.enter_async_context(self._platform.robot(f"r{number}")) for number in range(ROBOTS)]
            through = {}
            for robot in robots:
                environment = robot.environment(f"{robot.name}_home")
                await robot.create_environment(environment.tag)
                through[environment.tag] = await through_node(robot, environment)
            flows = [*through.values(), await between(robots[0], robots[1])]
            try:
                yield Robots(robots, flows, through)
            finally:
                for flow in flows:
                    await flow.end()

    # --- faults -------------------------------------------------------------------------------------------------------

    async def _fail(self, robots: Robots, until: float) -> None:
        nemesis = faults.Nemesis(self._platform, self._probes_of(robots))
        done = 0
        for worker in self._workers:
            worker.resume()
        while done < self._plan.events and time.monotonic() < until:
            batch = [self._choose(robots)]
            if self._random.random() < TWO_AT_ONCE:
                other = self._choose(robots)
                batch += [other] if other.victim != batch[0].victim else []
            async with asyncio.TaskGroup() as tasks:
                for fault in batch:
                    tasks.create_task(self._one(nemesis, fault, robots, alone=len(batch) == 1))
            before, done = done, done + len(batch)
            self._progress(done, self._model.acknowledged)
            await asyncio.sleep(self._random.uniform(*PAUSE))
            if done // AUDIT_EVERY > before // AUDIT_EVERY:
                await self._audit(robots)
        await self._audit(robots)

    def _choose(self, robots: Robots) -> faults.Fault:
        return faults.choose(self._random, list(robots.through), bool(self._platform.disks), self._plan.long)

    async def _one(self, nemesis: faults.Nemesis, fault: faults.Fault, robots: Robots, *, alone: bool) -> None:
        self._history.add("nemesis", fault)
        began = time.monotonic()
        ended = await nemesis.strike(fault)
        seconds = await nemesis.recovered(fault, ended)
        self._history.add("nemesis", fault, f"recovered in {seconds:.2f} s")
        if fault.victim == TASK_SET:
            await self._remove_probe(robots.robots[0])
        self._events[fault.label] += 1
        if alone:
            self._recoveries[fault.label].append(seconds)
        for flow in _may_lose(fault, robots):
            flow.disturb(began, time.monotonic())

    async def _remove_probe(self, robot: Robot) -> None:
        """Remove the environment whose start showed that the task set works."""
        while True:
            try:
                return await robot.destroy_environment(PROBE)
            except NotFound:
                return
            except FAULTS:
                await asyncio.sleep(RETRY_INTERVAL)

    async def _audit(self, robots: Robots) -> None:
        """Let all commands end, and compare."""
        await asyncio.gather(*(worker.stop() for worker in self._workers))
        what = f"{len(self._model.facts)} facts"
        self._history.add("audit", what)
        self._audits.append(await audit.settle(self._model.facts, partial(audit.look, self._platform)))
        self._history.add("audit", what, "agree")
        problems = [problem for flow in robots.flows for problem in flow.count().problems()]
        if problems:
            raise Violation("\n".join(problems))
        for worker in self._workers:
            worker.resume()

    # --- probes -------------------------------------------------------------------------------------------------------

    def _probes_of(self, robots: Robots) -> dict[str, faults.Probe]:
        """Return by victim what it must do to count as recovered."""

        async def through(flows: Sequence[Flow], since: float) -> None:
            await asyncio.gather(*(flow.wait_for_message(since, faults.RECOVERY_TIMEOUT) for flow in flows))

        def flowing(*flows: Flow) -> faults.Probe:
            return lambda since: through(flows, since)

        maps = self._platform.maps()
        home = next(iter(robots.through))

        async def command(since: float) -> None:
            self._probes += 1
            step = Step("add", ("parameter", home, PROBE, str(self._probes)))
            await robots.robots[0].set_parameter(home, PROBE, str(self._probes))
            self._model.acknowledge(step)

        async def start(since: float) -> None:
            await robots.robots[0].create_environment(PROBE, exist_ok=True, restart="no")

        async def ask_maps(since: float) -> None:
            await asyncio.to_thread(maps.uploads)

        probes: dict[str, faults.Probe] = {"master": command, TASK_SET: start, MAPS: ask_maps}
        probes |= {name: flowing(*robots.flows) for name in ENDPOINTS}
        for tag, flow in robots.through.items():
            probes |= {faults.ENVIRONMENT + tag: flowing(flow), faults.NODE_OF + tag: flowing(flow)}
        return probes


def _may_lose(fault: faults.Fault, robots: Robots) -> list[Flow]:
    """Return the flows whose messages may have been in the memory of a victim when it was killed."""
    if fault.kind == "disk" or (fault.kind == "stop" and fault.seconds < faults.LONG_STOP):
        return []
    if fault.victim in ENDPOINTS:
        return robots.flows
    return [flow for tag, flow in robots.through.items() if fault.victim.endswith(f" {tag}")]


async def _watch_drops(robot: Robot, flows: list[Flow]) -> None:
    """Take in the drops that the platform reports to a robot, for its flows."""
    async for event in robot.events():
        if isinstance(event, DropEvent):
            for flow in flows:
                if flow.name.startswith(f"{robot.name} ") or flow.name.endswith(f" {robot.name}"):
                    flow.report(event)
