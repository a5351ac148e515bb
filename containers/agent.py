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
from containers.engine import LAST_LINES
from containers.logfile import LONGEST_LINE
from containers.relay import Relay
from containers.swarm_agents import ROLE
from containers.swarm_node import NodeDaemon, Task
from containers.swarm_spec import Names
from rce import __version__, loop
from rce.calls import (
    Call,
    Cleared,
    ClearRun,
    ContainerEnded,
    Hello,
    KnowRelays,
    MeasureUsage,
    NodeReport,
    Nothing,
    Usage,
    Welcome,
)
from rce.control import Handlers, MasterLink
from rce.errors import RceError, Unavailable
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
        self._served: dict[str, _Served] = {}  # by run
        self._dead: set[str] = set()  # runs that Docker says are dead: its list says so a moment later
        self._told: set[str] = set()  # runs whose end the task set knows of
        self._report: NodeReport | None = None
        self._happening = asyncio.Event()
        handlers = Handlers()
        handlers.on(ClearRun, self._clear)
        handlers.on(KnowRelays, self._know)
        handlers.on(MeasureUsage, self._measure)
        self._link = MasterLink(reactor, settings.task_set, self._hello, handlers, self._welcomed, self._tls)

    async def run(self) -> None:
        """Until it is cancelled, or the task set refuses it."""
        address = await self._docker.follow(self._happened, self._happening.set)
        await self._data_relay.listen(address, self._settings.data_port)
        watching = asyncio.create_task(self._watch())
        joined = asyncio.create_task(self._link.run())
        try:
            await asyncio.wait({watching, joined}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (watching, joined):
                task.cancel()
            await asyncio.wait({watching, joined})
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
        tasks = await self._docker.tasks()
        self._dead &= {task.run for task in tasks}
        running = {task.run: task for task in tasks if task.running and task.run not in self._dead}
        for task in running.values():
            if task.run not in self._served:
                await self._serve(task)
        for run in [run for run in self._served if run not in running]:
            self._serve_no_more(run)
        for task in tasks:
            if (task.ended or task.run in self._dead) and task.run not in self._told:
                await self._tell_end(task)
        await self._docker.sweep({task.run for task in tasks})
        report = NodeReport(
            sorted(running), await self._docker.images(), _protected(), self._data_relay.address.removeprefix("relay:")
        )
        if report != self._report and self._link.connected:
            await self._tell(report)
            self._report = report

    async def _serve(self, task: Task) -> None:
        names = Names.of(self._labels, task.name, task.run)
        served = self._served[task.run] = _Served(task.name, Relay(self._reactor, self._settings.master, self._tls))
        control, sockets = await self._docker.volume(names.control), await self._docker.volume(names.sockets)
        try:
            await self._data_relay.admit(task.name, sockets / names.places.socket.name, control)
            (control / GATE).with_suffix(".address").write_text(self._data_relay.address)
            await served.relay.open(control)  # last: who has reached the Master says where it is reached itself
        except OSError as error:
            log.warn("{name} is not served: {error}", name=task.name, error=str(error))  # it has just ended
            self._serve_no_more(task.run)

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
        found = call.run in {task.run for task in await self._docker.tasks()}
        await self._docker.remove_all(f"{RUN}={call.run}")
        self._serve_no_more(call.run)
        await self._docker.sweep({task.run for task in await self._docker.tasks()})
        return Cleared(found)

    async def _know(self, call: KnowRelays) -> Nothing:
        self._data_relay.know(call.relays)
        return Nothing()

    async def _measure(self, _: MeasureUsage) -> Usage:
        return Usage(await self._docker.usage())

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
