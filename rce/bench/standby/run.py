"""A run: robots give commands and send messages, the leader fails, and the platform is compared with the model."""

from __future__ import annotations

import asyncio
import random
import time
from collections import Counter, defaultdict
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path
from typing import NamedTuple

from rce.api.views import accounts as views
from rce.bench.chaos import audit
from rce.bench.chaos.flows import Flow, between
from rce.bench.chaos.history import History
from rce.bench.chaos.model import Model, Step
from rce.bench.chaos.violations import Violation, violation
from rce.bench.chaos.workload import RobotWorker
from rce.bench.standby.faults import Fault, Nemesis, choose
from rce.bench.standby.platform import ADMINISTRATOR, MASTERS, TASK_SETS, Platform, running
from rce.bench.standby.report import Result
from rce.bench.standby.terms import TermWatch, Writer, stale
from rce.client import Robot
from rce.errors import RceError

AUDIT_EVERY = 10  # faults
PAUSE = 0.0, 0.5  # seconds between a recovery and the next fault
TAKE_OVER_LIMIT = 60.0  # seconds until a Master must lead; what it took is in the result
PROBE = "probe"


class Plan(NamedTuple):
    """Extent of a run, which ends when one of the bounds is reached.

    Attributes:
        seed: Seed of all random choices.
        events: Maximum number of faults.
        seconds: Maximum duration.
        robots: Number of robots, each with an environment.
        faults: Faults in place of random ones.
    """

    seed: int
    events: int
    seconds: float
    robots: int = 5
    faults: tuple[Fault, ...] = ()


async def measure(directory: Path, plan: Plan, progress: Callable[[int, int], None] = lambda *_: None) -> Result:
    """Run a platform in a directory and let its leader fail.

    Args:
        directory: Empty directory; `history.jsonl` and `log` remain in it.
        plan: Extent of the run.
        progress: Called with the number of faults and with the number of acknowledged commands.

    Raises:
        Unavailable: There is no PostgreSQL, or there are no network namespaces.
        Violation: The platform did not keep a promise; the message has the seed and the ends of history and logs.
    """
    history = History(directory / "history.jsonl")
    try:
        async with running(directory) as platform:
            try:
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
        self._terms = TermWatch(platform.database.local)
        self._workers: list[RobotWorker] = []
        self._events: Counter[str] = Counter()
        self._take_overs: list[float] = []
        self._commands: dict[str, list[float]] = defaultdict(list)
        self._audits: list[float] = []
        self._probes = 0

    async def measure(self) -> Result:
        """Run until a bound of the plan is reached, and compare at the end.

        Raises:
            Violation: The platform did not keep a promise.
        """
        began = time.monotonic()
        clients = {each: self._platform.api(ADMINISTRATOR, each) for each in MASTERS}
        writers = [Writer(client, self._platform.url(each), each) for each, client in clients.items()]
        async with self._robots() as (robots, flows), asyncio.TaskGroup() as tasks:
            self._model = Model((await asyncio.to_thread(self._look)).facts)
            self._workers = [RobotWorker(each, self._model, self._history, self._plan.seed) for each in robots]
            working = [tasks.create_task(self._terms.run())]
            await self._terms.wait_for_another("", TAKE_OVER_LIMIT)
            working += [tasks.create_task(each.run()) for each in self._workers]
            working += [tasks.create_task(each.run()) for each in writers]
            await self._fail(robots[0], began + self._plan.seconds)
            for flow in flows:
                await flow.end()
            for task in working:
                task.cancel()
        await self._check_writes(writers)
        problems = [problem for flow in flows for problem in flow.count().problems()]
        if problems:
            raise Violation("\n".join(problems))
        return Result(
            self._plan.seed,
            time.monotonic() - began,
            dict(self._events),
            self._model.acknowledged,
            dict(sum((worker.refused for worker in self._workers), Counter[str]())),
            sum(len(writer.acknowledged) for writer in writers),
            len(self._terms.terms),
            self._take_overs,
            dict(self._commands),
            self._audits,
            [flow.count() for flow in flows],
            max(flow.longest_gap() for flow in flows),
            all(each.can_jump for each in self._platform.clocks.values()),
        )

    @asynccontextmanager
    async def _robots(self) -> AsyncIterator[tuple[list[Robot], list[Flow]]]:
        """Connect the robots, each with an environment, and begin their flows in a ring."""
        async with AsyncExitStack() as stack:
            names = [f"r{number}" for number in range(self._plan.robots)]
            robots = [await stack.enter_async_context(self._platform.robot(name)) for name in names]
            for robot in robots:
                await robot.create_environment(f"{robot.name}_home")
            flows = [await between(one, other) for one, other in zip(robots, [*robots[1:], robots[0]], strict=True)]
            try:
                yield robots, flows
            finally:
                for flow in flows:
                    await flow.end()

    def _look(self) -> audit.Found:
        directories = [self._platform.directory / each for each in TASK_SETS]
        return audit.look_without_maps(self._platform.api(), self._platform.api(ADMINISTRATOR), directories)

    # --- faults -------------------------------------------------------------------------------------------------------

    async def _fail(self, robot: Robot, until: float) -> None:
        nemesis = Nemesis(self._platform, self._terms)
        clocks = all(each.can_jump for each in self._platform.clocks.values())
        for worker in self._workers:
            worker.resume()
        for number in range(1, self._plan.events + 1):
            if time.monotonic() > until:
                break
            planned = self._plan.faults[number - 1 :]
            await self._one(nemesis, planned[0] if planned else choose(self._random, clocks), robot)
            self._progress(number, self._model.acknowledged)
            await asyncio.sleep(self._random.uniform(*PAUSE))
            if number % AUDIT_EVERY == 0:
                await self._audit()
        await self._audit()

    async def _one(self, nemesis: Nemesis, fault: Fault, robot: Robot) -> None:
        """Let a fault happen; wait until a Master leads and executes a command of a robot."""
        if fault.deposes:
            await asyncio.to_thread(self._platform.wait_for_masters)
        self._history.add("nemesis", fault, f"begins, {self._terms.url} leads")
        began, leader = time.monotonic(), self._terms.url
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(nemesis.strike(fault))
            if fault.deposes:
                took_over = await self._terms.wait_for_another(leader, TAKE_OVER_LIMIT) - began
                self._take_overs.append(took_over)
                self._history.add("nemesis", fault, f"{self._terms.url} leads after {took_over:.2f} s")
            await self._command(robot)
            self._commands[fault.label].append(time.monotonic() - began)
        self._history.add("nemesis", fault, "is over")
        self._events[fault.label] += 1

    async def _command(self, robot: Robot) -> None:
        """Give a command that changes something; return when it is acknowledged."""
        self._probes += 1
        home, value = f"{robot.name}_home", str(self._probes)
        while True:
            try:
                await robot.set_parameter(home, PROBE, value)
            except RceError as error:
                self._history.add("probe", value, f"{error.info.code}: {error}"[:300])
                await asyncio.sleep(0.1)
            else:
                return self._model.acknowledge(Step("add", ("parameter", home, PROBE, value)))

    # --- comparison ---------------------------------------------------------------------------------------------------

    async def _audit(self) -> None:
        """Let all commands end, and compare."""
        await asyncio.gather(*(worker.stop() for worker in self._workers))
        what = f"{len(self._model.facts)} facts"
        self._history.add("audit", what)
        self._audits.append(await audit.settle(self._model.facts, self._look))
        self._history.add("audit", what, "agree")
        for worker in self._workers:
            worker.resume()

    async def _check_writes(self, writers: list[Writer]) -> None:
        """Check that no Master acknowledged a write in another one's term, and that what they acknowledged is there.

        Raises:
            Violation: It is not so.
        """
        problems = stale([write for each in writers for write in each.acknowledged], self._terms.terms)
        keys = await asyncio.to_thread(lambda: list(self._platform.api(ADMINISTRATOR).items(views.KeyView, "keys")))
        present = {key.id for key in keys}
        problems += [
            f"missing: key {label}" for each in writers for id, label in each.kept.items() if id not in present
        ]
        if problems:
            raise Violation("\n".join(problems))
