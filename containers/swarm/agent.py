"""`python -P -m containers.swarm.agent`: the agent that the engine `swarm` runs on each node, in the node's network.

It serves the sockets of the environments on its node, as the task set does with the engine `docker`. It reports the
ends of their containers to the task set at once, whereas Swarm's manager would have to be polled, and removes what they
leave. Docker's events only trigger a check; the agent acts on the state that it then reads from Docker.
"""

from __future__ import annotations

import asyncio
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct
from twisted.internet.base import ReactorBase
from twisted.logger import Logger

from containers.control_relay import ControlRelay
from containers.data_relay import DataRelay
from containers.data_socket import DataSocket
from containers.docker.daemon import RUN, describe
from containers.docker.events import Event
from containers.docker.networks import Networks
from containers.engine import LAST_LINES
from containers.fetching import Fetcher
from containers.logfile import LONGEST_LINE
from containers.settings import EGRESS_POOL
from containers.swarm.agents import ROLE
from containers.swarm.node import NodeDaemon, Task
from containers.swarm.resources import ResourceProvider
from containers.swarm.spec import Names
from rce import __version__
from rce.control.calls.agents import (
    ContainerEnded,
    EnvironmentUnusable,
    NodeReport,
    PullImage,
    RemovedRun,
    RemoveRun,
    SetGroupMembers,
    SetMaster,
)
from rce.control.calls.call import Call, Nothing
from rce.control.calls.environments import SetRelays
from rce.control.calls.joining import Hello, SetRemovedMachines, Welcome
from rce.control.calls.watching import MeasureUsage, Usage
from rce.control.client import ControlClient
from rce.control.connection import Handlers
from rce.errors import RceError, StartFailed, Unavailable
from rce.net.tls import load_tls
from rce.process import loop
from rce.process.metrics import Family, gauge_family
from rce.process.settings import load_or_exit

PROGRAM = "rce agent"
RETRY_DELAY = 1.0  # seconds until the next try after Docker did not answer
log = Logger()


class Settings(Struct, frozen=True):
    """RCE agent: serves the environments of one node of a swarm. The task set starts it."""

    master: Annotated[str, Meta(description="control address of the Master")]
    task_set: Annotated[str, Meta(description="control address of the task set")]
    token: Annotated[str, Meta(description="secret that the task set shares with its agents")]
    node: Annotated[str, Meta(description="id of this node")]
    platform: Annotated[str, Meta(description="name of the task set")]
    directory: Annotated[str, Meta(description="directory of the task set")]
    tls: Annotated[Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem of this node")] = None
    data_port: Annotated[int, Meta(description="port for data links; 0 takes a free one")] = 0
    entry: Annotated[str, Meta(description="URL of the Master's HTTP entry; empty: on the host of `master`")] = ""
    egress_pool: Annotated[str, Meta(description="network of which each egress network gets a /30")] = EGRESS_POOL
    nameservers: Annotated[list[str], Meta(description="nameservers of environments with an egress network")] = []


@dataclass
class _Served:
    """An environment whose sockets are open."""

    name: str
    relay: ControlRelay
    data_socket: DataSocket


class Agent:
    """Serves the environments of one node for its task set."""

    def __init__(self, reactor: ReactorBase, settings: Settings) -> None:
        self._reactor = reactor
        self._settings = settings
        self._master = settings.master
        self._labels = {"rce.platform": settings.platform, "rce.directory": settings.directory}
        self._docker = NodeDaemon(self._labels)
        self._tls = load_tls(settings.tls)
        self._data_relay = DataRelay(self._tls)
        self._networks = Networks(self._docker.call, self._labels, settings.egress_pool, settings.nameservers)
        self._served: dict[str, _Served] = {}  # by run
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
        handlers = Handlers()
        handlers.on(RemoveRun, self._remove_run)
        handlers.on(SetRelays, self._set_relays)
        handlers.do(SetRemovedMachines, self._refuse_removed)
        handlers.on(MeasureUsage, self._measure_usage)
        handlers.on(SetGroupMembers, self._set_group_members)
        handlers.do(SetMaster, self._set_master)
        handlers.on(PullImage, self._pull_image)
        handlers.serve_metrics(ROLE, self._data_relay.families, self._families)
        self._link = ControlClient(reactor, settings.task_set, self._hello, handlers, self._welcomed, self._tls)
        fetcher = Fetcher(self._link, settings.master, settings.entry, self._tls)
        self._resources = ResourceProvider(self._docker, self._labels, self._networks, fetcher)

    async def run(self) -> None:
        """Serve until cancelled or refused by the task set, whose error is then raised."""
        address = await self._docker.follow(self._on_event, self._on_resumed)
        await self._networks.recover()
        await self._data_relay.listen(address, self._settings.data_port)
        watching = asyncio.create_task(self._watch())
        joined = asyncio.create_task(self._link.run())
        filtering = asyncio.create_task(self._networks.watch())
        try:
            await asyncio.wait({watching, joined}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            under_way = {watching, joined, filtering, *self._preparing.values()}
            for task in under_way:
                task.cancel()
            await asyncio.wait(under_way)
            self._docker.close()
            await self._data_relay.close()
        for task in (watching, joined):
            if not task.cancelled():
                task.result()

    def _hello(self) -> Hello:
        return Hello(ROLE, self._settings.node, self._settings.token, __version__)

    def _welcomed(self, _: Welcome) -> None:
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
            if task.run not in self._served and task.run not in self._preparing and task.run not in self._end_reported:
                self._preparing[task.run] = asyncio.create_task(self._prepare(task))
        for run in [run for run in self._served if run not in running]:
            self._stop_serving(run)
        connected = self._link.connected
        for task in tasks:
            if connected and (task.ended or task.run in self._dead) and task.run not in self._end_reported:
                await self._report_end(task)
        await self._docker.sweep({task.run for task in tasks})
        self._adopted = set(self._preparing if self._adopted is None else self._adopted & self._preparing.keys())
        report = NodeReport(
            sorted({*self._served, *self._adopted}),
            await self._docker.images(),
            _denies_new_privileges(),
            self._data_relay.address.removeprefix("relay:"),
        )
        # Only after all ends: the task set takes a run that is missing in a report for one whose end nobody saw.
        if report != self._report and connected and self._link.connected:
            await self._notify(report)
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
                await self._notify(EnvironmentUnusable(task.run, reason.info))
        finally:
            del self._preparing[task.run]
            self._check_needed.set()

    async def _serve(self, task: Task) -> None:
        names = Names.of(self._labels, task.name, task.run)
        control, sockets = await self._docker.volume(names.control), await self._docker.volume(names.sockets)
        path = sockets / names.paths.socket.name
        relay, data_socket = ControlRelay(self._reactor, self._master, self._tls), DataSocket(path)
        await self._data_relay.add_environment(task.name, path, control)
        self._served[task.run] = _Served(task.name, relay, data_socket)
        data_socket.offer(control)
        await relay.open(control)  # last, because an endpoint that has reached the Master may be dialled

    def _stop_serving(self, run: str) -> None:
        served = self._served.pop(run, None)
        if served is None:
            return
        served.relay.close()
        served.data_socket.remove()
        if all(other.name != served.name for other in self._served.values()):  # a new run may have this name
            self._data_relay.remove_environment(served.name)

    async def _report_end(self, task: Task) -> None:
        state = await self._docker.state(task.run)
        if state is None or not self._link.connected:
            return  # reported when this agent has joined again, unless the container is removed by then
        lines = await self._docker.last_lines(task.run, LAST_LINES)
        status, reason = describe(state)
        self._end_reported.add(task.run)
        await self._notify(ContainerEnded(task.run, reason, status, [line[:LONGEST_LINE] for line in lines]))

    # --- calls of the task set ----------------------------------------------------------------------------------------

    async def _remove_run(self, call: RemoveRun) -> RemovedRun:
        self._end_reported.add(call.run)
        names = [task.name for task in await self._docker.tasks() if task.run == call.run]
        if call.run in self._preparing:
            self._preparing[call.run].cancel()
            await asyncio.wait({self._preparing[call.run]})
        await self._docker.remove_all(f"{RUN}={call.run}")
        self._stop_serving(call.run)
        for name in names:
            await self._networks.leave(name)
        await self._docker.sweep({task.run for task in await self._docker.tasks()})
        return RemovedRun(bool(names))

    async def _set_relays(self, call: SetRelays) -> Nothing:
        self._data_relay.set_relays(call.relays)
        return Nothing()

    def _refuse_removed(self, call: SetRemovedMachines) -> None:
        if self._tls is not None:
            self._tls.set_removed(call.machines)

    def _set_master(self, call: SetMaster) -> None:
        self._master = call.master
        for served in self._served.values():
            served.relay.lead(call.master)

    async def _measure_usage(self, _: MeasureUsage) -> Usage:
        return Usage(await self._docker.usage())

    def _families(self) -> list[Family]:
        here: dict[tuple[str, ...], float] = {("served",): len(self._served), ("furnished",): len(self._preparing)}
        return [gauge_family("rce_environments_here", "Environments of this node by state", ["state"], here)]

    async def _pull_image(self, call: PullImage) -> Nothing:
        await self._docker.pull(call)
        self._check_needed.set()
        return Nothing()

    async def _set_group_members(self, call: SetGroupMembers) -> Nothing:
        await self._resources.set_group_members(call.name, call.members, await self._docker.tasks())
        return Nothing()

    async def _notify(self, call: Call[Any]) -> None:
        try:
            await self._link.call(call)
        except RceError as error:
            log.info("the task set did not take {call}: {error}", call=type(call).__name__, error=str(error))


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
