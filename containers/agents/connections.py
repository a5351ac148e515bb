"""Connections of the task set to its agents, one on each node."""

from __future__ import annotations

import asyncio
import hmac
import os
import secrets
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import msgspec
from msgspec import Struct
from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort
from twisted.logger import Logger

from containers.ports import close_port
from rce.control.calls.agents import NodeReport, PullImage, RemoveRun, SetGroupMembers, SetMaster
from rce.control.calls.call import Call, Nothing
from rce.control.calls.environments import Group, SetRelays
from rce.control.calls.joining import Hello, SetRemovedMachines, Welcome
from rce.control.calls.watching import EnvironmentUsage, MeasureUsage, ReadMetrics
from rce.control.connection import Control, Handlers
from rce.control.server import listen
from rce.errors import Lost, RceError, Unauthorized
from rce.net.tls import Tls
from rce.process.metrics import Family

log = Logger()
ROLE = "agent"
R = TypeVar("R")
METRICS_TIMEOUT = 3.0  # seconds for an agent to answer; less than the Master waits for the task set


class AgentAccess(Struct, frozen=True):
    """Secret and ports by which agents reach their task set, kept for its next start; ports are 0 before the first."""

    secret: str
    port: int
    images: int = 0  # port of the image registry

    @staticmethod
    def load(file: Path) -> AgentAccess:
        """Read a file that `store` wrote; make a new secret if there is none."""
        try:
            return msgspec.json.decode(file.read_bytes(), type=AgentAccess)
        except FileNotFoundError:
            return AgentAccess(secrets.token_hex(32), 0)

    def store(self, file: Path) -> None:
        """Write a file that only its owner can read.

        Raises:
            OSError: The file cannot be written.
        """
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        draft = file.with_suffix(".new")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
            stream.write(msgspec.json.encode(self))
        draft.rename(file)


@dataclass
class _Agent:
    """An agent that has joined; `report` is None until it has sent its first."""

    node: str
    control: Control | None = None
    report: NodeReport | None = None
    relays: list[str] = field(default_factory=list)  # the data relays that it was told


class Agents:
    """The agents that have joined with `secret`, at most one for each node.

    `relays` has the data relay of each node whose agent has ever reported, as HOST:PORT.
    `reported` is called with the id of the node after each NodeReport; `add_handlers` adds the handlers of all other
    calls that agents make.
    """

    def __init__(self, secret: str, reported: Callable[[str], None], add_handlers: Callable[[Handlers], None]) -> None:
        self._secret = secret
        self._reported = reported
        self._add_handlers = add_handlers
        self._agents: dict[str, _Agent] = {}
        self._changed = asyncio.Event()
        self._master = SetMaster("")
        self._port: IListeningPort | None = None
        self.relays: dict[str, str] = {}
        self._other_relays: list[str] = []
        self._removed = SetRemovedMachines({})
        self._notifying: set[asyncio.Task[None]] = set()

    async def listen(self, reactor: ReactorBase, description: str, tls: Tls | None = None) -> int:
        """Accept agents at a Twisted server endpoint; return the port."""
        self._port = await listen(reactor, description, self, tls)
        address = self._port.getHost()  # type: ignore[misc]  # zope declares it without self
        return int(address.port)

    async def close(self) -> None:
        """Stop listening and close all connections; the agents keep running and join the next task set."""
        if self._port is not None:
            await close_port(self._port)
            self._port = None
        for agent in self._agents.values():
            if agent.control is not None:
                agent.control.close()
        self._agents.clear()

    async def wait_for_reports(self, nodes: Collection[str], seconds: float) -> set[str]:
        """Wait at most `seconds` until the agents of these nodes have reported; return the nodes that lack a report."""
        await self.wait_until(lambda: not self._without_report(nodes), seconds)
        return self._without_report(nodes)

    async def wait_until(self, condition: Callable[[], bool], seconds: float) -> None:
        """Wait at most `seconds` until reports of agents make a condition true."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while not condition():
                    self._changed.clear()
                    await self._changed.wait()

    def _without_report(self, nodes: Collection[str]) -> set[str]:
        return {node for node in nodes if self.report(node) is None}

    def report(self, node: str) -> NodeReport | None:
        """Return the newest report of a node's agent; None if no agent has reported."""
        agent = self._agents.get(node)
        return agent.report if agent else None

    def image_id(self, tag: str) -> str | None:
        """Return the id that a tag has on most of the nodes that have such an image; None if no node has one."""
        reports = [agent.report for agent in self._agents.values() if agent.report is not None]
        ids = Counter(report.images[tag] for report in reports if tag in report.images)
        return ids.most_common(1)[0][0] if ids else None

    def has_image(self, node: str, image: str) -> bool:
        """Return True if a node has an agent and the image with this id."""
        report = self.report(node)
        return report is not None and image in report.images.values()

    async def remove_run(self, node: str, run: str) -> bool:
        """Remove everything of an environment from a node; return True if its agent found a container of it."""
        agent = self._agents.get(node)
        if agent is None or agent.control is None:
            return False
        try:
            return (await agent.control.call(RemoveRun(run))).found
        except Lost:
            return False

    async def remove_run_everywhere(self, run: str) -> bool:
        """Remove everything of an environment from all nodes; return True if any agent found a container of it."""
        return any(await asyncio.gather(*(self.remove_run(node, run) for node in list(self._agents))))

    async def usage(self) -> dict[str, EnvironmentUsage]:
        """Return the resources that environments have used, by name, without nodes that do not answer."""
        controls = [agent.control for agent in self._agents.values() if agent.control is not None]
        answers = await asyncio.gather(*(control.call(MeasureUsage()) for control in controls), return_exceptions=True)
        found: dict[str, EnvironmentUsage] = {}
        for answer in answers:
            if isinstance(answer, RceError):  # the node or its Docker is down
                log.info("the usage on a node was not measured: {error}", error=str(answer))
            elif isinstance(answer, BaseException):
                raise answer
            else:
                found |= answer.environments
        return found

    async def metrics(self) -> dict[str, list[Family]]:
        """Return the metrics of the agents by the ids of their nodes; agents that do not answer are left out."""
        joined = [agent for agent in self._agents.values() if agent.control is not None]
        answers = await asyncio.gather(*(_metrics(agent.control) for agent in joined if agent.control is not None))
        return {agent.node: families for agent, families in zip(joined, answers, strict=True) if families}

    def set_relays(self, relays: Collection[str]) -> None:
        """Send the agents the data relays of other machines, together with those of all agents."""
        self._other_relays = list(relays)
        self._send_relays()

    def set_removed_machines(self, machines: Mapping[str, float]) -> None:
        """Send the agents when machines were removed."""
        self._removed = SetRemovedMachines(dict(machines))
        for agent in self._agents.values():
            if agent.control is not None:
                self._notify_later(agent.control, self._removed)

    def set_master(self, master: str) -> None:
        """Tell the agents which Master leads."""
        self._master = SetMaster(master)
        for agent in self._agents.values():
            if agent.control is not None:
                self._notify_later(agent.control, self._master)

    async def pull_image(self, node: str, call: PullImage) -> None:
        """Have a node pull an image; return when it has it.

        Raises:
            StartFailed: The node's Docker did not pull the image.
            Lost: The node has no agent.
        """
        await self.call(node, call)

    async def call(self, node: str, call: Call[R]) -> R:
        """Make a call to the agent of a node; return its result.

        Raises:
            Lost: The node has no agent.
            RceError: What the agent has raised.
        """
        agent = self._agents.get(node)
        if agent is None or agent.control is None:
            raise Lost(f"node {node} has no agent")
        return await agent.control.call(call)

    async def set_group_members(self, group: Group) -> None:
        """Send all agents the members of a group."""
        call = SetGroupMembers(group.name, group.members)
        joined = [agent.control for agent in self._agents.values() if agent.control is not None]
        await asyncio.gather(*(_notify(each, call) for each in joined))

    # --- calls of agents ---------------------------------------------------------------------------------------------

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        """Admit an agent that knows the secret; see `rce.control.server.Joiner`.

        Raises:
            Unauthorized: The peer is not an agent of this task set.
        """
        if hello.role != ROLE or not hmac.compare_digest(hello.token.encode(), self._secret.encode()):
            raise Unauthorized(f"{address}: only agents of this task set may join here")
        agent = _Agent(hello.name)
        handlers = Handlers()

        async def report(call: NodeReport) -> Nothing:
            agent.report = call
            self._handle_report(agent)
            return Nothing()

        handlers.on(NodeReport, report)
        self._add_handlers(handlers)
        return Welcome(""), handlers, lambda joined: self._joined(agent, joined)

    def _joined(self, agent: _Agent, joined: Control) -> None:
        before = self._agents.get(agent.node)
        if before is not None and before.control is not None:
            before.control.close()
        agent.control = joined
        self._agents[agent.node] = agent
        joined.lost.add_done_callback(lambda _: self._left(agent))
        if self._removed.machines:
            self._notify_later(joined, self._removed)
        if self._master.master:
            self._notify_later(joined, self._master)
        if agent.report is not None:
            self._handle_report(agent)

    def _handle_report(self, agent: _Agent) -> None:
        if self._agents.get(agent.node) is agent:
            self._changed.set()
            if agent.report is not None:
                self.relays[agent.node] = agent.report.relay
            self._send_relays()
            self._reported(agent.node)

    def _left(self, agent: _Agent) -> None:
        if self._agents.get(agent.node) is agent:
            del self._agents[agent.node]
            log.info("lost the agent of node {node}", node=agent.node)

    def _send_relays(self) -> None:
        relays = sorted({*self._other_relays, *self.relays.values()})
        for agent in self._agents.values():
            if agent.control is not None and agent.relays != relays:
                agent.relays = relays
                self._notify_later(agent.control, SetRelays(relays))

    def _notify_later(self, agent: Control, call: Call[Nothing]) -> None:
        task = asyncio.create_task(_notify(agent, call))
        self._notifying.add(task)
        task.add_done_callback(self._notifying.discard)


async def _metrics(agent: Control) -> list[Family]:
    try:
        return (await asyncio.wait_for(agent.call(ReadMetrics()), METRICS_TIMEOUT)).families
    except (RceError, TimeoutError) as error:  # its node is down or busy
        log.info("an agent did not send its metrics: {error}", error=str(error))
        return []


async def _notify(agent: Control, call: Call[Nothing]) -> None:
    try:
        await agent.call(call)
    except RceError as error:  # an agent gets the current state again when it joins
        log.info("an agent did not take {call}: {error}", call=type(call).__name__, error=str(error))
