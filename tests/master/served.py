"""A Master whose HTTP entry is served for real, and whose processes exist in memory and do all that they are told."""

from __future__ import annotations

import asyncio
import http.client
import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, NamedTuple, cast

import argon2
import msgspec
from twisted.internet import endpoints
from twisted.internet.base import ReactorBase

import rce
from master.api.resources import make_api
from master.api.site import ApiSite
from master.depot import Depot
from master.entry import Entry
from master.policies import Policy
from master.service import Master
from master.store import Store
from master.users import digest
from rce import http as client
from rce.calls.call import Call, Nothing, Settled
from rce.calls.endpoints import Sync
from rce.calls.environments import StartEnvironment, StopEnvironment
from rce.calls.joining import Hello
from rce.calls.robots import Definitions, Describe, Login
from rce.calls.watching import CountTraffic, Log, MeasureUsage, ReadGraph, ReadLog, RosGraph, Traffic, Usage
from rce.control import Control, Handlers
from rce.errors import RceError

PASSWORD = "secret"


class Answer(NamedTuple):
    status: int
    body: Any
    headers: dict[str, str]


class Peer:
    """A process in memory, as a Control: `refuse` has what it answers with an error, `told` what it was called with."""

    handlers: Handlers

    def __init__(self, served: Served, hello: Hello) -> None:
        self.address = "memory"
        self.lost: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.told: list[Call[Any]] = []
        self.refuse: dict[type[Call[Any]], RceError] = {}
        self.answers: dict[type[Call[Any]], Any] = {
            Sync: Settled(),
            Describe: Definitions({}),
            CountTraffic: Traffic({}),
            ReadGraph: RosGraph([], []),
            ReadLog: Log([]),
            MeasureUsage: Usage({}),
        }
        self._served = served
        self._hello = hello

    async def call(self, call: Call[Any]) -> Any:
        await asyncio.sleep(0)
        self.told.append(call)
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
    """Users ann, bob, olga (operator), vera (viewer) and root (admin) with the password `secret`; Robot endpoint
    `west`, machine `m1`. Environments do not come up while `starts` is false.
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
        await self.master.processes.allow(name, role, f"token of {name}")
        return await self.join(Hello(role, name, f"token of {name}", rce.__version__, "1", **hello))

    async def robot(self, user: str, robot: str, endpoint: str = "west") -> None:
        """A robot's login at its Robot endpoint."""
        await self.said(endpoint, Login(user, robot, digest(PASSWORD)))

    async def said(self, process: str, call: Call[Any]) -> Any:
        """What a process tells the Master."""
        handlers = self.peers[process].handlers
        good, pages = await handlers.answer(type(call).__name__, [msgspec.msgpack.encode(call)])
        assert good, pages
        return pages

    async def until_told(self, process: str, call: Call[Any]) -> None:
        """Returns once a process was called so."""
        async with asyncio.timeout(20):
            while call not in self.peers[process].told:  # noqa: ASYNC110  # it has no event of its own
                await asyncio.sleep(0.001)

    async def ask(
        self, method: str, path: str, user: str = "ann", body: Any = None, secret: str = PASSWORD, **headers: str
    ) -> Answer:
        """One request below /api/v1."""
        content = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
        given = (client.basic(user, secret) if user else {}) | {"Connection": "close"} | headers
        if body is not None:
            given.setdefault("Content-Type", "application/json")

        def do() -> Answer:
            connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
            connection.request(method, "/api/v1" + path, content, given)
            response = connection.getresponse()
            text = response.read()
            connection.close()
            told = {name.lower(): value for name, value in response.getheaders()}
            return Answer(response.status, json.loads(text) if text else None, told)

        return await asyncio.to_thread(do)


@asynccontextmanager
async def serve(
    reactor: ReactorBase, files: Path, policy: Policy | None = None, at: str = "tcp:0:interface=127.0.0.1"
) -> AsyncIterator[Served]:
    store = Store("sqlite://")
    await store.open()
    depot = Depot(files / "depot")
    master = Master(store, 1000, policy or Policy(), depot=depot)
    master.users.passwords.hasher = argon2.PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)  # many sign in
    for user, role in (("ann", "user"), ("bob", "user"), ("olga", "operator"), ("vera", "viewer"), ("root", "admin")):
        await master.users.add(user, PASSWORD, role)  # type: ignore[arg-type]
    await master.start()
    site = ApiSite(Entry(master.state), make_api(master, depot), depot)
    endpoint = endpoints.serverFromString(reactor, at)
    port = await endpoint.listen(site).asFuture(asyncio.get_running_loop())
    served = Served(master, port.getHost().port)
    await served.process("robot", "west", url="ws://:1/", addresses=["tcp:x:1"])
    await served.process("container", "m1", capacity=1000)
    try:
        yield served
    finally:
        await port.stopListening().asFuture(asyncio.get_running_loop())
        for peer in served.peers.values():
            peer.close()
        await master.stop()
        await store.close()
