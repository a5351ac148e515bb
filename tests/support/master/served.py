"""A Master with a real HTTP server, and processes in memory that do whatever it calls."""

from __future__ import annotations

import asyncio
import http.client
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import argon2
from twisted.internet.base import ReactorBase

import rce
from master.access.users import digest
from master.api.resources import make_api
from master.api.router import Api
from master.api.site import Site
from master.graph.limits import Policy
from master.graph.state import State
from master.service import Master
from master.storage.depot import Depot
from rce.api import http as client
from rce.control.calls.call import BatchResult, Call, Nothing
from rce.control.calls.endpoints import Sync
from rce.control.calls.environments import StartEnvironment, StopEnvironment
from rce.control.calls.joining import Hello
from rce.control.calls.recordings import AnnounceRecording, ListRecordings, RecordingInfo, Recordings
from rce.control.calls.robots import Definitions, DescribeType, Executed, Login
from rce.control.calls.watching import (
    CountTraffic,
    Log,
    MeasureUsage,
    ReadGraph,
    ReadLog,
    ReadPackages,
    RosGraph,
    RosPackages,
    Traffic,
    Usage,
)
from rce.control.connection import Control, Handlers
from rce.errors import RceError
from rce.web.server import Endpoint, parse_endpoint
from tests.support.control import answer
from tests.support.master.database import open_store

PASSWORD = "secret"


class Answer(NamedTuple):
    status: int
    body: Any
    headers: dict[str, str]


class Peer:
    """A process in memory, in place of a Control: `refuse` has its errors by type of call, `calls` what it got."""

    handlers: Handlers

    def __init__(self, served: Served, hello: Hello) -> None:
        self.address = "memory"
        self.fell_silent = False
        self.lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.calls: list[Call[Any]] = []
        self.refuse: dict[type[Call[Any]], RceError] = {}
        self.answers: dict[type[Call[Any]], Any] = {
            Sync: BatchResult(),
            DescribeType: Definitions({}),
            CountTraffic: Traffic({}),
            ReadGraph: RosGraph([], []),
            ReadPackages: RosPackages([]),
            ReadLog: Log([]),
            MeasureUsage: Usage({}),
            ListRecordings: Recordings([]),
            AnnounceRecording: RecordingInfo("0f3c", "a.mcap", "uploading", 0, 0.0, length=1),
        }
        self._served = served
        self._hello = hello

    async def call(self, call: Call[Any], seconds: float = 0.0) -> Any:
        await asyncio.sleep(0)
        self.calls.append(call)
        if type(call) in self.refuse:
            raise self.refuse[type(call)]
        match call:
            case StartEnvironment(spec) if self._served.starts:
                await self._served.join(Hello("environment", spec.name, spec.token, rce.__version__, spec.run))
            case StopEnvironment(name) if name in self._served.peers:
                self._served.peers.pop(name).close()
        answer = self.answers.get(type(call), Nothing())
        return await answer(call) if callable(answer) else answer

    def close(self) -> None:
        if not self.lost.done():
            self.lost.set_result(None)


class Served:
    """A Master with users, the Robot endpoint `west` and the machine `m1`.

    Users are ann, bob, olga (operator), vera (viewer) and root (admin), with the password `secret`. Environments do not
    start while `starts` is false.
    """

    def __init__(self, master: Master, port: int) -> None:
        self.master = master
        self.port = port
        self.url = f"http://127.0.0.1:{port}"
        self.peers: dict[str, Peer] = {}
        self.starts = True

    async def join(self, hello: Hello) -> Peer:
        peer = Peer(self, hello)
        _, handlers, joined = await self.master.join(hello, peer.address)
        self.peers[hello.name] = peer
        peer.handlers = handlers
        joined(cast(Control, peer))
        return peer

    async def process(self, role: Any, name: str, **hello: Any) -> Peer:
        await self.master.join_tokens.allow(name, role, f"token of {name}")
        return await self.join(Hello(role, name, f"token of {name}", rce.__version__, "1", **hello))

    async def leave(self, process: str) -> None:
        """Let a process disconnect; return once the Master has noticed."""
        self.peers.pop(process).close()
        async with asyncio.timeout(20):
            while process in self.master.state.joined:  # noqa: ASYNC110  # it has no event of its own
                await asyncio.sleep(0)

    async def robot(self, user: str, robot: str, endpoint: str = "west") -> None:
        """Log a robot in at a Robot endpoint."""
        await self.call_master(endpoint, Login(user, robot, digest(PASSWORD)))

    async def call_master(self, process: str, call: Call[Any]) -> Any:
        """Call the Master as a process does."""
        handlers = self.peers[process].handlers
        found = await answer(handlers, call)
        if isinstance(found, Executed):
            assert not found.failed, found.failed
        return found

    async def wait_for_call(self, process: str, call: Call[Any]) -> None:
        """Return once the Master has made this call to a process."""
        async with asyncio.timeout(20):
            while call not in self.peers[process].calls:  # noqa: ASYNC110  # it has no event of its own
                await asyncio.sleep(0.001)

    async def ask(
        self, method: str, path: str, user: str = "ann", body: Any = None, secret: str = PASSWORD, **headers: str
    ) -> Answer:
        """Make one request below /api/v1."""
        content = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
        sent = (client.basic(user, secret) if user else {}) | {"Connection": "close"} | headers
        if body is not None:
            sent.setdefault("Content-Type", "application/json")

        def do() -> Answer:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
            connection.request(method, "/api/v1" + path, content, sent)
            response = connection.getresponse()
            text = response.read()
            connection.close()
            received = {name.lower(): value for name, value in response.getheaders()}
            return Answer(response.status, json.loads(text) if text else None, received)

        return await asyncio.to_thread(do)


@asynccontextmanager
async def serve_entry(state: State, files: Path) -> AsyncIterator[int]:
    """Serve the entry and the dashboard of a state, with an API that has no routes; yields the port."""
    nothing: Any = None  # without routes nobody is authenticated
    site = Site(state, Api(nothing, nothing), Depot(files / "depot"))
    _, port = await site.start(Endpoint("127.0.0.1", 0))
    yield port
    await site.stop()


@asynccontextmanager
async def serve(
    reactor: ReactorBase, files: Path, policy: Policy | None = None, at: str = "tcp:0:interface=127.0.0.1"
) -> AsyncIterator[Served]:
    """Serve a Master; `reactor` is the fixture, which checks that nothing is left behind."""
    store = await open_store()
    depot = Depot(files / "depot")
    master = Master(store, 1000, policy or Policy(), depot=depot)
    master.users.passwords.hasher = argon2.PasswordHasher(
        time_cost=1, memory_cost=8, parallelism=1
    )  # there are many logins
    for user, role in (("ann", "user"), ("bob", "user"), ("olga", "operator"), ("vera", "viewer"), ("root", "admin")):
        await master.users.add(user, PASSWORD, role)  # type: ignore[arg-type]
    await master.start()
    site = Site(master.state, make_api(master, depot), depot)
    _, port = await site.start(parse_endpoint(at))
    served = Served(master, port)
    await served.process("robot", "west", url="ws://:1/", addresses=["tcp:x:1"])
    await served.process("container", "m1", capacity=1000)
    try:
        yield served
    finally:
        await site.stop()
        for peer in served.peers.values():
            peer.close()
        await master.stop()
        await store.close()
