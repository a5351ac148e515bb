"""Master with real control connections, and processes that join it over loopback."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

import argon2
import sqlalchemy as sa
from twisted.internet.base import ReactorBase

import rce
from master.access.users import digest
from master.service import Master
from rce.api.knowledge_requests import KnowledgeAnswer
from rce.bench.hollow import DONE
from rce.control.calls.call import BatchResult, Call, Nothing
from rce.control.calls.endpoints import AddRoute, Bind, Sync
from rce.control.calls.environments import KeepEnvironments, SetRelays, StartEnvironment, StopEnvironment
from rce.control.calls.joining import Hello, SetRemovedMachines
from rce.control.calls.knowledge import AnswerKnowledge
from rce.control.calls.robots import Definitions, DescribeType, Execute, Executed, LoggedIn, Login, SendStatus
from rce.control.calls.watching import ReadGraph, RosGraph, RosNode
from rce.control.client import connect
from rce.control.connection import Control, Handlers
from rce.control.server import listen
from rce.errors import ErrorInfo
from rce.net.tls import Tls
from rce.protocol import messages as m
from tests.support.master.database import open_store

T = TypeVar("T", bound=Call[Any])
LONG = 1000.0  # a grace period that outlasts a test
PATIENCE = 20.0  # seconds until a test that hangs fails
QUICK_HASHER = argon2.PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)  # there are many logins


class Peer:
    """Process that has joined the Master: records calls, and answers errors from `refuse`."""

    def __init__(self, platform: Platform, hello: Hello) -> None:
        self.platform = platform
        self.hello = hello
        self.arrived: list[Call[Any]] = []
        self.refuse: dict[type[Call[Any]], Exception] = {}
        self.failed: dict[str, ErrorInfo] = {}  # failures in the answer to Sync
        self.answering = asyncio.Event()  # clear it to let requests to the knowledge service wait
        self.answering.set()
        self._changed = asyncio.Event()
        self._taken = 0

    async def join(self) -> Peer:
        handlers = Handlers()
        for kind in (
            *(*DONE, Bind, AddRoute),
            *(StartEnvironment, StopEnvironment, KeepEnvironments, SetRelays, SetRemovedMachines),
        ):
            handlers.on(kind, self._take)
        handlers.on(Sync, self._sync)
        handlers.on(DescribeType, self._describe)
        handlers.on(ReadGraph, self._read_graph)
        handlers.on(AnswerKnowledge, self._answer_knowledge)
        self.control, welcome = await connect(self.platform.reactor, self.platform.address, self.hello, handlers)
        self.platform.controls.append(self.control)
        self.credential = welcome.credential
        return self

    async def _take(self, call: Call[Any]) -> Nothing:
        self.arrived.append(call)
        self._changed.set()
        if type(call) in self.refuse:
            raise self.refuse[type(call)]
        return Nothing()

    async def _sync(self, call: Sync) -> BatchResult:
        await self._take(call)
        return BatchResult(self.failed)

    async def _describe(self, call: DescribeType) -> Definitions:
        return Definitions({call.type: f"of {self.hello.name}"})

    async def _read_graph(self, call: ReadGraph) -> RosGraph:
        return RosGraph([], [], [], [RosNode(f"/{self.hello.name}")])

    async def _answer_knowledge(self, call: AnswerKnowledge) -> KnowledgeAnswer:
        await self._take(call)
        await self.answering.wait()
        return KnowledgeAnswer(data=b"known")

    async def next(self, kind: type[T]) -> T:
        """Return the next call of this kind, skipping others."""

        async def search() -> T:
            while True:
                while self._taken < len(self.arrived):
                    call = self.arrived[self._taken]
                    self._taken += 1
                    if isinstance(call, kind):
                        return call
                self._changed.clear()
                await self._changed.wait()

        return await asyncio.wait_for(search(), PATIENCE)

    async def call(self, call: Call[Any]) -> Any:
        return await asyncio.wait_for(self.control.call(call), PATIENCE)

    async def leave(self) -> None:
        self.control.close()
        await self.platform.until(lambda: self.hello.name not in self.platform.master.state.joined)


class Platform:
    """Master and the processes that joined it. With `tls` set, its control port has TLS."""

    tls: Tls | None = None

    def __init__(self, reactor: ReactorBase, database: str, grace: float) -> None:
        self.reactor = reactor
        self.database = database
        self.grace = grace
        self.controls: list[Control] = []

    async def start(self) -> None:
        self.store = await open_store(self.database)
        self.master = Master(self.store, self.grace, tls=self.tls)
        self.master.users.passwords.hasher = QUICK_HASHER
        await self.master.start()
        self.port = await listen(self.reactor, "tcp:0:interface=127.0.0.1", self.master, self.tls)
        self.address = f"tcp:127.0.0.1:{self.port.getHost().port}"  # type: ignore[misc]  # zope declares its methods without self

    async def stop(self) -> None:
        await asyncio.sleep(0)
        self.port.stopListening()  # type: ignore[misc]  # as above
        for control in [*self.controls, *self.master._runner.dispatcher.controls.values()]:
            control.close()
        await asyncio.wait_for(asyncio.gather(*(control.lost for control in self.controls)), PATIENCE)
        await self.until(lambda: not self.master.state.joined)
        self.controls.clear()
        await self.master.stop()
        await self.store.close()

    async def fill_disk(self, full: bool = True) -> None:
        """Leave the database no room to grow, or give it room again."""
        limit = sa.text(f"PRAGMA max_page_count = {1 if full else 1 << 30}")  # 1: the pages that it has
        await self.store.run(lambda connection: connection.execute(limit))

    async def until(self, true: Callable[[], bool]) -> None:
        async def poll() -> None:
            while not true():  # noqa: ASYNC110  # what is looked at has no event of its own
                await asyncio.sleep(0.001)

        await asyncio.wait_for(poll(), PATIENCE)

    async def process(self, role: Any, name: str, incarnation: str = "1", **hello: Any) -> Peer:
        token = hello.pop("token", "")
        if not token:
            token = f"token of {name} {incarnation} {len(self.controls)}"
            await self.master.join_tokens.allow(name, role, token)
        return await Peer(self, Hello(role, name, token, rce.__version__, incarnation, **hello)).join()

    async def endpoint(self, name: str = "west", incarnation: str = "1", **hello: Any) -> Peer:
        return await self.process("robot", name, incarnation, url="ws://:1/", addresses=["tcp:x:1"], **hello)

    async def environment(self, machine: Peer) -> Peer:
        """Join with the token of the next start at the machine."""
        spec = (await machine.next(StartEnvironment)).environment
        peer = await self.process("environment", spec.name, spec.run, token=spec.token)
        await peer.next(Sync)
        return peer


def execute(endpoint: Peer, robot: str, command: m.Command, again: bool = False) -> Awaitable[None]:
    async def call() -> None:
        executed: Executed = await endpoint.call(Execute.of(robot, command, again=again))
        executed.raise_first_error()

    return asyncio.ensure_future(call())


async def login(endpoint: Peer, robot: str, resume: str = "") -> LoggedIn:
    user, _, tag = robot.partition("/")
    answer: LoggedIn = await endpoint.call(Login(user, tag, digest("secret"), resume, ["events"]))
    return answer


class Furnished:
    """Endpoint west with ann/r1, machine m1, environment ann/brain, and r1/pose connected with brain/pose."""

    def __init__(self, platform: Platform) -> None:
        self.platform = platform

    async def build(self) -> Furnished:
        self.west = await self.platform.endpoint()
        self.m1 = await self.platform.process("container", "m1", capacity=4)
        self.session = await login(self.west, "ann/r1")
        made = execute(self.west, "ann/r1", m.CreateContainer("brain"))
        self.brain = await self.platform.environment(self.m1)
        await made
        for command in (
            m.AddInterface("r1", "pose", "SubscriberConverter", "std_msgs/String"),
            m.AddInterface("brain", "pose", "PublisherInterface", "std_msgs/String"),
            m.Connect("r1/pose", "brain/pose"),
        ):
            await execute(self.west, "ann/r1", command)
        (link,) = self.platform.master.state.links
        self.link = link.name
        return self


async def told(west: Peer, kind: type[Any]) -> Any:
    while True:
        tell = await west.next(SendStatus)
        for said in (tell.status, tell.error):
            if isinstance(said, kind):
                return said
