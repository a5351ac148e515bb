"""`python -P -m containers.agent`: what the engine `swarm` runs on each node, in the node's network.

It serves the sockets of the environments on its node, as the task set itself does with the engine `docker`; reports
ends of their containers to the task set at once, which Swarm's manager would have to be asked for; and removes what
they leave. Docker's events only make it look; what it finds is what counts.
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

from containers.data_relay import GATE, DataRelay
from containers.docker_daemon import RUN, describe
from containers.docker_events import Event
from containers.docker_networks import Networks
from containers.engine import LAST_LINES
from containers.fetching import Fetcher
from containers.furnishing import Furnisher
from containers.logfile import LONGEST_LINE
from containers.relay import Relay
from containers.settings import EGRESS_POOL
from containers.swarm_agents import ROLE
from containers.swarm_node import NodeDaemon, Task
from containers.swarm_spec import Names
from rce import __version__, loop
from rce.calls.agents import Cleared, ClearRun, ContainerEnded, HaveImage, KnowGroup, NodeReport, Unfit
from rce.calls.call import Call, Nothing
from rce.calls.environments import KnowRelays
from rce.calls.joining import Hello, Welcome
from rce.calls.watching import MeasureUsage, Usage
from rce.control import Handlers, MasterLink
from rce.errors import RceError, StartFailed, Unavailable
from rce.metrics import Family, gauge
from rce.settings import load_or_exit
from rce.tls import load

PROGRAM = "rce agent"
PAUSE = 1.0  # seconds until Docker is asked again that did not answer
log = Logger()


class Settings(Struct, frozen=True):
    """RCE agent: serves the environments of one node of a swarm. The task set starts it."""

    master: Annotated[str, Meta(description="control address of the Master")]
    task_set: Annotated[str, Meta(description="control address of the task set")]
    token: Annotated[str, Meta(description="what the task set knows its agents by")]
    node: Annotated[str, Meta(description="id of this node")]
    platform: Annotated[str, Meta(description="name of the task set")]
    directory: Annotated[str, Meta(description="directory of the task set")]
    tls: Annotated[Path | None, Meta(description="directory with ca.pem, cert.pem and key.pem of this node")] = None
    data_port: Annotated[int, Meta(description="port for data links; 0 takes a free one")] = 0
    entry: Annotated[str, Meta(description="URL of the Master's HTTP entry; empty: on the host of `master`")] = ""
    egress_pool: Annotated[str, Meta(description="network of which environments that reach out get a /30")] = (
        EGRESS_POOL
    )
    nameservers: Annotated[list[str], Meta(description="whom such environments ask for names")] = []


@dataclass
class _Served:
    name: str
    relay: Relay


class Agent:
    """One node's environments, in its task set's service."""

    def __init__(self, reactor: ReactorBase, settings: Settings) -> None:
        self._reactor = reactor
        self._settings = settings
        self._labels = {"rce.platform": settings.platform, "rce.directory": settings.directory}
        self._docker = NodeDaemon(self._labels)
        self._tls = load(settings.tls)
        self._data_relay = DataRelay(self._tls)
        self._networks = Networks(self._docker.ask, self._labels, settings.egress_pool, settings.nameservers)
        self._served: dict[str, _Served] = {}  # by run
        self._furnishing: dict[str, asyncio.Task[None]] = {}  # by run
        self._dead: set[str] = set()  # runs that Docker says are dead: its list says so a moment later
        self._told: set[str] = set()  # runs whose end the task set knows of
        self._report: NodeReport | None = None
        self._present: set[str] = set()  # names of which a container was here at the last look
        self._guard = False
        self._happening = asyncio.Event()
        handlers = Handlers()
        handlers.on(ClearRun, self._clear)
        handlers.on(KnowRelays, self._know)
        handlers.on(MeasureUsage, self._measure)
        handlers.on(KnowGroup, self._know_group)
        handlers.on(HaveImage, self._have_image)
        handlers.tell_metrics(ROLE, self._data_relay.families, self._families)
        self._link = MasterLink(reactor, settings.task_set, self._hello, handlers, self._welcomed, self._tls)
        fetcher = Fetcher(self._link, settings.master, settings.entry, self._tls)
        self._furnisher = Furnisher(self._docker, self._labels, self._networks, fetcher)

    async def run(self) -> None:
        """Until it is cancelled, or the task set refuses it."""
        address = await self._docker.follow(self._happened, self._taken_up)
        await self._networks.recover()
        await self._data_relay.listen(address, self._settings.data_port)
        watching = asyncio.create_task(self._watch())
        joined = asyncio.create_task(self._link.run())
        try:
            await asyncio.wait({watching, joined}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            under_way = {watching, joined, *self._furnishing.values()}
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
        """It may be another task set, that knows nothing yet."""
        self._told.clear()
        self._report = None
        self._happening.set()

    def _happened(self, event: Event) -> None:
        if event["Action"] == "die" and RUN in event["Actor"]["Attributes"]:
            self._dead.add(event["Actor"]["Attributes"][RUN])
        self._happening.set()

    def _taken_up(self) -> None:
        """Docker was away, or is there for the first time."""
        self._guard = True
        self._happening.set()

    # --- what is here -------------------------------------------------------------------------------------------------

    async def _watch(self) -> None:
        while True:
            await self._happening.wait()
            self._happening.clear()
            try:
                await self._look()
            except Unavailable as error:
                log.warn("{error}", error=str(error))
                await asyncio.sleep(PAUSE)
                self._happening.set()

    async def _look(self) -> None:
        if self._guard:
            await self._networks.guard()
            self._guard = False
        tasks = await self._docker.tasks()
        self._dead &= {task.run for task in tasks}
        self._told &= {task.run for task in tasks}
        for name in self._present - {task.name for task in tasks}:
            await self._networks.leave(name)
        self._present = {task.name for task in tasks}
        running = {task.run: task for task in tasks if task.running and task.run not in self._dead}
        for task in running.values():
            if task.run not in self._served and task.run not in self._furnishing and task.run not in self._told:
                self._furnishing[task.run] = asyncio.create_task(self._furnish(task))
        for run in [run for run in self._served if run not in running]:
            self._serve_no_more(run)
        for task in tasks:
            if (task.ended or task.run in self._dead) and task.run not in self._told:
                await self._tell_end(task)
        await self._docker.sweep({task.run for task in tasks})
        report = NodeReport(
            sorted(self._served),
            await self._docker.images(),
            _protected(),
            self._data_relay.address.removeprefix("relay:"),
        )
        if report != self._report and self._link.connected:
            await self._tell(report)
            self._report = report

    async def _furnish(self, task: Task) -> None:
        """Give an environment what it needs, and open its way to the Master."""
        try:
            await self._furnisher.furnish(task)
            await self._serve(task)
        except (RceError, OSError) as error:
            if task.run not in self._dead:
                self._told.add(task.run)
                reason = error if isinstance(error, RceError) else StartFailed(str(error))
                log.warn("{name} cannot be served: {error}", name=task.name, error=str(error))
                await self._tell(Unfit(task.run, reason.info))
        finally:
            del self._furnishing[task.run]
            self._happening.set()

    async def _serve(self, task: Task) -> None:
        names = Names.of(self._labels, task.name, task.run)
        control, sockets = await self._docker.volume(names.control), await self._docker.volume(names.sockets)
        relay = Relay(self._reactor, self._settings.master, self._tls)
        await self._data_relay.admit(task.name, sockets / names.places.socket.name, control)
        self._served[task.run] = _Served(task.name, relay)
        (control / GATE).with_suffix(".address").write_text(self._data_relay.address)
        await relay.open(control)  # last: who has reached the Master says where it is reached itself

    def _serve_no_more(self, run: str) -> None:
        served = self._served.pop(run, None)
        if served is None:
            return
        served.relay.close()
        if all(other.name != served.name for other in self._served.values()):  # else it is a new life's by now
            self._data_relay.dismiss(served.name)

    async def _tell_end(self, task: Task) -> None:
        state = await self._docker.state(task.run)
        if state is None or not self._link.connected:
            return  # it is told when this agent has joined again, unless all of it is removed by then
        lines = await self._docker.last_lines(task.run, LAST_LINES)
        status, reason = describe(state)
        self._told.add(task.run)
        await self._tell(ContainerEnded(task.run, reason, status, [line[:LONGEST_LINE] for line in lines]))

    async def _clear(self, call: ClearRun) -> Cleared:
        self._told.add(call.run)
        names = [task.name for task in await self._docker.tasks() if task.run == call.run]
        if call.run in self._furnishing:
            self._furnishing[call.run].cancel()
            await asyncio.wait({self._furnishing[call.run]})
        await self._docker.remove_all(f"{RUN}={call.run}")
        self._serve_no_more(call.run)
        for name in names:
            await self._networks.leave(name)
        await self._docker.sweep({task.run for task in await self._docker.tasks()})
        return Cleared(bool(names))

    async def _know(self, call: KnowRelays) -> Nothing:
        self._data_relay.know(call.relays)
        return Nothing()

    async def _measure(self, _: MeasureUsage) -> Usage:
        return Usage(await self._docker.usage())

    def _families(self) -> list[Family]:
        here: dict[tuple[str, ...], float] = {("served",): len(self._served), ("furnished",): len(self._furnishing)}
        return [gauge("rce_environments_here", "Environments of this node, by how far they are", ["state"], here)]

    async def _have_image(self, call: HaveImage) -> Nothing:
        await self._docker.pull(call)
        self._happening.set()
        return Nothing()

    async def _know_group(self, call: KnowGroup) -> Nothing:
        await self._furnisher.know(call.name, call.members, await self._docker.tasks())
        return Nothing()

    async def _tell(self, call: Call[Any]) -> None:
        try:
            await self._link.call(call)
        except RceError as error:
            log.info("the task set did not hear {call}: {error}", call=type(call).__name__, error=str(error))


def _protected() -> bool:
    """Whether Docker here denies containers new privileges: this program is in one."""
    return "NoNewPrivs:\t1" in Path("/proc/self/status").read_text()


def main() -> int:
    settings = load_or_exit(Settings, PROGRAM)
    os.environ.pop("RCE_TOKEN", None)
    return loop.run(lambda reactor: Agent(reactor, settings).run())


if __name__ == "__main__":
    sys.exit(main())
