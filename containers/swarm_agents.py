"""The agents of a swarm's nodes as their task set sees them."""

from __future__ import annotations

import asyncio
import hmac
import os
import secrets
from collections import Counter
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
from msgspec import Struct
from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort
from twisted.logger import Logger

from rce import control
from rce.calls.agents import ClearRun, HaveImage, KnowGroup, NodeReport
from rce.calls.call import Call, Nothing
from rce.calls.environments import Group, KnowRelays
from rce.calls.joining import Hello, Welcome
from rce.calls.watching import MeasureUsage, ReadMetrics, Used
from rce.control import Control, Handlers
from rce.errors import Lost, RceError, Unauthorized
from rce.metrics import Family
from rce.tls import Tls

log = Logger()
ROLE = "agent"
PATIENCE = 3.0  # seconds for an agent's metrics; the Master has more with the task set


class Kept(Struct, frozen=True):
    """What agents know of their task set, the same for the next one; ports are 0 before the first."""

    secret: str
    port: int
    images: int = 0  # the port of the registry

    @staticmethod
    def load(file: Path) -> Kept:
        try:
            return msgspec.json.decode(file.read_bytes(), type=Kept)
        except FileNotFoundError:
            return Kept(secrets.token_hex(32), 0)

    def store(self, file: Path) -> None:
        """Readable by its owner only; raises OSError."""
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        draft = file.with_suffix(".new")
        draft.unlink(missing_ok=True)
        with os.fdopen(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
            stream.write(msgspec.json.encode(self))
        draft.rename(file)


@dataclass
class _Agent:
    """One that has joined; `report` is None until it has said what is on its node."""

    node: str
    control: Control | None = None
    report: NodeReport | None = None
    knows: list[str] = field(default_factory=list)  # relays


class Agents:
    """Takes agents that know `secret`, one for each node.

    `reported` is called with the node whenever an agent says what is there; `handlers` answer all else that agents say.
    """

    def __init__(self, secret: str, reported: Callable[[str], None], handlers: Callable[[Handlers], None]) -> None:
        self._secret = secret
        self._reported = reported
        self._handlers = handlers
        self._agents: dict[str, _Agent] = {}
        self._changed = asyncio.Event()
        self._port: IListeningPort | None = None
        self._others: list[str] = []
        self._telling: set[asyncio.Task[None]] = set()

    async def listen(self, reactor: ReactorBase, description: str, tls: Tls | None = None) -> int:
        """Take agents at a Twisted server endpoint; returns the port."""
        self._port = await control.listen(reactor, description, self, tls)
        address = self._port.getHost()  # type: ignore[misc]  # zope declares it without self
        return int(address.port)

    async def close(self) -> None:
        """Take none any more, and let go of those that are here; they go on, and join the next task set."""
        if self._port is not None:
            self._port.stopListening()  # type: ignore[misc]  # zope declares its methods without self
        for agent in self._agents.values():
            if agent.control is not None:
                agent.control.close()
        self._agents.clear()

    async def wait_for(self, nodes: Collection[str], seconds: float) -> set[str]:
        """Until the agents of these nodes have reported, or it takes too long; returns the nodes without."""
        await self.until(lambda: not self._without_report(nodes), seconds)
        return self._without_report(nodes)

    async def until(self, condition: Callable[[], bool], seconds: float) -> None:
        """Wait for agents to report what makes a condition true, or for so long."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while not condition():
                    self._changed.clear()
                    await self._changed.wait()

    def _without_report(self, nodes: Collection[str]) -> set[str]:
        return {node for node in nodes if self.report(node) is None}

    def report(self, node: str) -> NodeReport | None:
        """What the agent of a node has said; None while there is no agent."""
        agent = self._agents.get(node)
        return agent.report if agent else None

    @property
    def relays(self) -> list[str]:
        """The data relays of the nodes, HOST:PORT."""
        reports = [agent.report for agent in self._agents.values() if agent.report is not None]
        return sorted(report.relay for report in reports)

    def image(self, tag: str) -> str | None:
        """The id of an image that most nodes have."""
        reports = [agent.report for agent in self._agents.values() if agent.report is not None]
        ids = Counter(report.images[tag] for report in reports if tag in report.images)
        return ids.most_common(1)[0][0] if ids else None

    def has(self, node: str, image: str) -> bool:
        """Whether a node has an agent, and the image with this id."""
        report = self.report(node)
        return report is not None and image in report.images.values()

    async def clear(self, node: str, run: str) -> bool:
        """Have all of an environment removed from a node; whether its agent found a container of it."""
        agent = self._agents.get(node)
        if agent is None or agent.control is None:
            return False
        try:
            return (await agent.control.call(ClearRun(run))).found
        except Lost:
            return False

    async def clear_everywhere(self, run: str) -> bool:
        """As `clear`, wherever it is."""
        return any(await asyncio.gather(*(self.clear(node, run) for node in list(self._agents))))

    async def usage(self) -> dict[str, Used]:
        """What the environments on all nodes have used, by name."""
        asked = [agent.control for agent in self._agents.values() if agent.control is not None]
        answers = await asyncio.gather(*(control.call(MeasureUsage()) for control in asked), return_exceptions=True)
        found: dict[str, Used] = {}
        for answer in answers:
            if isinstance(answer, RceError):  # its node is away, or its Docker
                log.info("a node was not measured: {error}", error=str(answer))
            elif isinstance(answer, BaseException):
                raise answer
            else:
                found |= answer.environments
        return found

    async def metrics(self) -> dict[str, list[Family]]:
        """What the agents count of themselves, by the ids of their nodes; one that does not answer is left out."""
        joined = [agent for agent in self._agents.values() if agent.control is not None]
        answers = await asyncio.gather(*(_metrics(agent.control) for agent in joined if agent.control is not None))
        return {agent.node: told for agent, told in zip(joined, answers, strict=True) if told}

    def know(self, relays: Collection[str]) -> None:
        """Tell the agents of the data relays of other machines; those of each other they learn here too."""
        self._others = list(relays)
        self._introduce()

    async def have_image(self, node: str, call: HaveImage) -> None:
        """Returns when a node has an image. StartFailed, Lost."""
        agent = self._agents.get(node)
        if agent is None or agent.control is None:
            raise Lost(f"node {node} has no agent")
        await agent.control.call(call)

    async def introduce(self, group: Group) -> None:
        """Tell all agents who is in a group."""
        call = KnowGroup(group.name, group.members)
        joined = [agent.control for agent in self._agents.values() if agent.control is not None]
        await asyncio.gather(*(_tell(each, call) for each in joined))

    # --- for rce.control ----------------------------------------------------------------------------------------------

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        if hello.role != ROLE or not hmac.compare_digest(hello.token.encode(), self._secret.encode()):
            raise Unauthorized(f"{address}: only agents of this task set may join here")
        agent = _Agent(hello.name)
        handlers = Handlers()

        async def report(call: NodeReport) -> Nothing:
            agent.report = call
            self._told(agent)
            return Nothing()

        handlers.on(NodeReport, report)
        self._handlers(handlers)
        return Welcome(""), handlers, lambda joined: self._joined(agent, joined)

    def _joined(self, agent: _Agent, joined: Control) -> None:
        before = self._agents.get(agent.node)
        if before is not None and before.control is not None:
            before.control.close()
        agent.control = joined
        self._agents[agent.node] = agent
        joined.lost.add_done_callback(lambda _: self._left(agent))
        if agent.report is not None:
            self._told(agent)

    def _told(self, agent: _Agent) -> None:
        if self._agents.get(agent.node) is agent:
            self._changed.set()
            self._introduce()
            self._reported(agent.node)

    def _left(self, agent: _Agent) -> None:
        if self._agents.get(agent.node) is agent:
            del self._agents[agent.node]
            log.info("the agent of node {node} is away", node=agent.node)

    def _introduce(self) -> None:
        relays = sorted({*self._others, *self.relays})
        for agent in self._agents.values():
            if agent.control is not None and agent.knows != relays:
                agent.knows = relays
                task = asyncio.create_task(_tell(agent.control, KnowRelays(relays)))
                self._telling.add(task)
                task.add_done_callback(self._telling.discard)


async def _metrics(agent: Control) -> list[Family]:
    try:
        return (await asyncio.wait_for(agent.call(ReadMetrics()), PATIENCE)).families
    except (RceError, TimeoutError) as error:  # its node is away, or busy
        log.info("an agent did not tell its metrics: {error}", error=str(error))
        return []


async def _tell(agent: Control, call: Call[Nothing]) -> None:
    try:
        await agent.call(call)
    except RceError as error:  # what it must know it is told when it joins again
        log.info("an agent did not hear {call}: {error}", call=type(call).__name__, error=str(error))
