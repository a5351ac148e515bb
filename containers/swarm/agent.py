"""`python -P -m containers.swarm.agent`: the agent that the engine `swarm` runs on each node, in the node's network.

It serves the sockets of the environments on its node, as the task set does with the engine `docker`. It reports the
ends of their containers to the task set at once, whereas Swarm's manager would have to be polled, and removes what they
leave. Docker's events only trigger a check; the agent acts on the state that it then reads from Docker.
"""

from __future__ import annotations

import asyncio
import os
import sys
from pathlib import Path
from typing import Annotated

from msgspec import Meta
from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from containers.agents.node import NodeServices, NodeSettings
from containers.docker.daemon import RUN, describe
from containers.docker.events import Event
from containers.docker.networks import Networks
from containers.engine import LAST_LINES
from containers.logfile import LONGEST_LINE
from containers.settings import EGRESS_POOL
from containers.swarm.node import NodeDaemon, Task
from containers.swarm.resources import ResourceProvider
from containers.swarm.spec import Names
from rce.control.calls.agents import (
    ContainerEnded,
    EnvironmentUnusable,
    NodeReport,
    PullImage,
    RemovedRun,
    RemoveRun,
    SetGroupMembers,
)
from rce.control.calls.call import Nothing
from rce.control.calls.watching import MeasureUsage, Usage
from rce.errors import RceError, StartFailed, Unavailable
from rce.process import loop
from rce.process.metrics import Family, gauge_family
from rce.process.settings import load_or_exit

PROGRAM = "rce agent"
RETRY_DELAY = 1.0  # seconds until the next try after Docker did not answer
log = Logger()


class Settings(NodeSettings, frozen=True, kw_only=True):
    """RCE agent: serves the environments of one node of a swarm. The task set starts it."""

    platform: Annotated[str, Meta(description="name of the task set")]
    directory: Annotated[str, Meta(description="directory of the task set")]
    egress_pool: Annotated[str, Meta(description="network of which each egress network gets a /30")] = EGRESS_POOL
    nameservers: Annotated[list[str], Meta(description="nameservers of environments with an egress network")] = []  # noqa: RUF012  # a Struct


class Agent:
    """Serves the environments of one node for its task set."""

    def __init__(self, reactor: ReactorBase, settings: Settings) -> None:
        self._labels = {"rce.platform": settings.platform, "rce.directory": settings.directory}
        self._docker = NodeDaemon(self._labels)
        self._networks = Networks(self._docker.call, self._labels, settings.egress_pool, settings.nameservers)
        self._preparing: dict[str, asyncio.Task[None]] = {}  # by run
        # Runs that were there when this agent started. They are reported before they are served again: a task set that
        # starts at the same time removes an environment that no agent reports.
        self._adopted: set[str] | None = None
        self._dead: set[str] = set()  # runs with a `die` event, which Docker's list shows only a moment later
        self._end_reported: set[str] = set()  # runs whose end the task set knows of
        self._report: NodeReport | None = None  # the last that was sent
        self._present: set[str] = set()  # names of environments that had a container at the last check
        self._restore_rules = False
        self._check_needed = asyncio.Event()
        self._services = NodeServices(reactor, settings, self._welcomed, self._families)
        handlers = self._services.handlers
        handlers.on(RemoveRun, self._remove_run)
        handlers.on(MeasureUsage, self._measure_usage)
        handlers.on(SetGroupMembers, self._set_group_members)
        handlers.on(PullImage, self._pull_image)
        self._resources = ResourceProvider(self._docker, self._labels, self._networks, self._services.fetcher)

    async def run(self) -> None:
        """Serve until cancelled or refused by the task set, whose error is then raised."""
        address = await self._docker.follow(self._on_event, self._on_resumed)
        await self._networks.recover()
        await self._services.listen(address)
        watching = asyncio.create_task(self._watch())
        joined = asyncio.create_task(self._services.link.run())
        filtering = asyncio.create_task(self._networks.watch())
        try:
            await asyncio.wait({watching, joined}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            under_way = {watching, joined, filtering, *self._preparing.values()}
            for task in under_way:
                task.cancel()
            await asyncio.wait(under_way)
            self._docker.close()
            await self._services.close()
        for task in (watching, joined):
            if not task.cancelled():
                task.result()

    def _welcomed(self) -> None:
        """Report everything again, as the task set may have been restarted."""
        self._end_reported.clear()
        self._report = None
        self._check_needed.set()

    def _on_event(self, event: Event) -> None:
        if event["Action"] == "die" and RUN in event["Actor"]["Attributes"]:
            self._dead.add(event["Actor"]["Attributes"][RUN])
        self._check_needed.set()

    def _on_resumed(self) -> None:
        """Check everything after Docker's event stream has begun, at first or after an interruption."""
        self._restore_rules = True
        self._check_needed.set()

    # --- environments of this node ------------------------------------------------------------------------------------

    async def _watch(self) -> None:
        while True:
            await self._check_needed.wait()
            self._check_needed.clear()
            try:
                await self._check()
            except Unavailable as error:
                log.warn("{error}", error=str(error))
                await asyncio.sleep(RETRY_DELAY)
                self._check_needed.set()

    async def _check(self) -> None:
        """Compare what is served with the containers in Docker, act on the difference and report it."""
        if self._restore_rules:
            await self._networks.restore_rules()
            self._restore_rules = False
        tasks = await self._docker.tasks()
        self._dead &= {task.run for task in tasks}
        self._end_reported &= {task.run for task in tasks}
        for name in self._present - {task.name for task in tasks}:
            await self._networks.leave(name)
        self._present = {task.name for task in tasks}
        running = {task.run: task for task in tasks if task.running and task.run not in self._dead}
        for task in running.values():
            if task.run not in self._services.served | self._preparing.keys() | self._end_reported:
                self._preparing[task.run] = asyncio.create_task(self._prepare(task))
        for run in self._services.served - running.keys():
            self._services.stop_serving(run)
        connected = self._services.link.connected
        for task in tasks:
            if connected and (task.ended or task.run in self._dead) and task.run not in self._end_reported:
                await self._report_end(task)
        await self._docker.sweep({task.run for task in tasks})
        self._adopted = set(self._preparing if self._adopted is None else self._adopted & self._preparing.keys())
        report = NodeReport(
            sorted(self._services.served | self._adopted),
            await self._docker.images(),
            _denies_new_privileges(),
            self._services.relay,
        )
        # Only after all ends: the task set takes a run that is missing in a report for one whose end nobody saw.
        if report != self._report and connected and self._services.link.connected:
            await self._services.notify(report)
            self._report = report

    async def _prepare(self, task: Task) -> None:
        """Provide an environment with its resources, then open its sockets."""
        try:
            await self._resources.provide(task)
            await self._serve(task)
        except (RceError, OSError) as error:
            if task.run not in self._dead:
                self._end_reported.add(task.run)
                reason = error if isinstance(error, RceError) else StartFailed(str(error))
                log.warn("{name} lacks a resource: {error}", name=task.name, error=str(error))
                await self._services.notify(EnvironmentUnusable(task.run, reason.info))
        finally:
            del self._preparing[task.run]
            self._check_needed.set()

    async def _serve(self, task: Task) -> None:
        names = Names.of(self._labels, task.name, task.run)
        control, sockets = await self._docker.volume(names.control), await self._docker.volume(names.sockets)
        await self._services.serve(task.name, task.run, control, sockets / names.paths.socket.name)

    async def _report_end(self, task: Task) -> None:
        state = await self._docker.state(task.run)
        if state is None or not self._services.link.connected:
            return  # reported when this agent has joined again, unless the container is removed by then
        lines = await self._docker.last_lines(task.run, LAST_LINES)
        status, reason = describe(state)
        self._end_reported.add(task.run)
        await self._services.notify(ContainerEnded(task.run, reason, status, [line[:LONGEST_LINE] for line in lines]))

    # --- calls of the task set ----------------------------------------------------------------------------------------

    async def _remove_run(self, call: RemoveRun) -> RemovedRun:
        self._end_reported.add(call.run)
        names = [task.name for task in await self._docker.tasks() if task.run == call.run]
        if call.run in self._preparing:
            self._preparing[call.run].cancel()
            await asyncio.wait({self._preparing[call.run]})
        await self._docker.remove_all(f"{RUN}={call.run}")
        self._services.stop_serving(call.run)
        for name in names:
            await self._networks.leave(name)
        await self._docker.sweep({task.run for task in await self._docker.tasks()})
        return RemovedRun(bool(names))

    async def _measure_usage(self, _: MeasureUsage) -> Usage:
        return Usage(await self._docker.usage())

    def _families(self) -> list[Family]:
        here: dict[tuple[str, ...], float] = {
            ("served",): len(self._services.served),
            ("furnished",): len(self._preparing),
        }
        return [gauge_family("rce_environments_here", "Environments of this node by state", ["state"], here)]

    async def _pull_image(self, call: PullImage) -> Nothing:
        await self._docker.pull(call)
        self._check_needed.set()
        return Nothing()

    async def _set_group_members(self, call: SetGroupMembers) -> Nothing:
        await self._resources.set_group_members(call.name, call.members, await self._docker.tasks())
        return Nothing()


def _denies_new_privileges() -> bool:
    """Return True if Docker on this node denies new privileges to containers, of which this process is in one."""
    return "NoNewPrivs:\t1" in Path("/proc/self/status").read_text()


def main() -> int:
    """Run the agent; return its exit status."""
    settings = load_or_exit(Settings, PROGRAM)
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: Agent(reactor, settings).run())


if __name__ == "__main__":
    sys.exit(main())
