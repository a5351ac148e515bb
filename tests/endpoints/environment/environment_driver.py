"""The test's side of an Environment endpoint: a Master that says what the test wants, and a Robot endpoint."""

from __future__ import annotations

import asyncio
import os
import secrets
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

from domains import domain
from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort

from endpoints.data_port import DataPort
from endpoints.frames import Message
from endpoints.hops import Watch
from endpoints.interface import Interface, error_of
from endpoints.link import Link
from endpoints.switchboard import Switchboard
from rce import control
from rce.calls.call import Call, Nothing
from rce.calls.endpoints import AddRoute, Bind, InterfaceSpec, LinkLost, LinkSpec, NodeDied, OpenLink, Report, Route
from rce.calls.joining import Hello, Welcome
from rce.errors import Unauthorized
from rce.messages import Qos

NAME = "user/env"
RUN = "ab" * 16
PACKAGES = Path(__file__).parent / "packages"
R = TypeVar("R")


class Robot(Interface):
    """One side of connections that collects what it gets."""

    def __init__(self, spec: InterfaceSpec, watch: Watch) -> None:
        super().__init__(spec, watch)
        self.got: asyncio.Queue[Message] = asyncio.Queue()
        self.answer: Callable[[Message], Message] | None = None

    def receive(self, message: Message, link: Link) -> None:
        if self.answer is not None:
            self.request(self.answer(message))
        else:
            self.got.put_nowait(message)

    async def next(self, patience: float = 10) -> bytes:
        """The next message; raises what an error message carries."""
        message = await asyncio.wait_for(self.got.get(), patience)
        if message.error:
            raise error_of(message)
        return bytes(message.payload)

    def publish(self, payload: bytes) -> None:
        self.send(Message(self.id, "nil", payload))

    async def ask(self, payload: bytes, patience: float = 10) -> bytes:
        self.request(Message(self.id, secrets.token_hex(16), payload))
        return await self.next(patience)


class FakeMaster:
    """Takes one Environment endpoint and drives it; `heard` are its reports."""

    def __init__(self, port: DataPort) -> None:
        self.hello: Hello
        self.heard: asyncio.Queue[Call[Any]] = asyncio.Queue()
        self.refuse = False
        self.joined: asyncio.Future[control.Control] = asyncio.get_running_loop().create_future()
        self.board = Switchboard(port, lambda link, reason: self.heard.put_nowait(LinkLost(link, reason)))
        self.listening: IListeningPort
        self._link = ""

    async def join(
        self, hello: Hello, address: str
    ) -> tuple[Welcome, control.Handlers, Callable[[control.Control], None]]:
        if self.refuse:
            raise Unauthorized("replaced")
        self.hello = hello
        handlers = control.Handlers()
        for kind in (NodeDied, LinkLost, Report):
            handlers.on(kind, self._hear)
        if self.joined.done():
            self.joined = asyncio.get_running_loop().create_future()
        return Welcome("credential"), handlers, self.joined.set_result

    async def _hear(self, call: Call[Any]) -> Nothing:
        self.heard.put_nowait(call)
        return Nothing()

    async def call(self, call: Call[R]) -> R:
        return await (await asyncio.wait_for(asyncio.shield(self.joined), 20)).call(call)

    async def link(self) -> str:
        """The name of a link to the environment, made when it is first asked for."""
        if not self._link:
            await asyncio.shield(self.joined)
            self._link, key = "link", secrets.token_hex(16)
            await self.call(OpenLink(LinkSpec(self._link, key)))
            self.board.open_link(LinkSpec(self._link, key, self.hello.addresses))
        return self._link

    async def bind(self, kind: str, type: str, addr: str, qos: Qos | None = None) -> InterfaceSpec:
        """An interface of the environment."""
        spec = InterfaceSpec(secrets.token_hex(16), NAME, f"tag{secrets.token_hex(4)}", kind, type, addr, qos or Qos())
        await self.call(Bind(spec))
        return spec

    async def connect(self, there: InterfaceSpec) -> Robot:
        """A robot's interface that is connected with one of the environment."""
        robots: list[Robot] = []

        async def make(spec: InterfaceSpec) -> Robot:
            robots.append(Robot(spec, self.board.watch))
            return robots[0]

        here = InterfaceSpec(secrets.token_hex(16), "user/robot", there.tag, "Converter", there.type, qos=there.qos)
        link = await self.link()
        await self.board.bind(here, make)
        receiving = there.kind in ("PublisherInterface", "ServiceProviderInterface")
        sides = [
            self.board.add_route(Route(here.id, there.id, link)),
            self.call(AddRoute(Route(there.id, here.id, link))),
        ]
        for side in reversed(sides) if receiving else sides:  # the receiving side first
            await side
        return robots[0]

    async def close(self) -> None:
        for name in list(self.board.links):
            self.board.close_link(name)
        stopping = self.listening.stopListening()  # type: ignore[misc]  # zope declares it without self
        if stopping is not None:
            await stopping.asFuture(asyncio.get_running_loop())

    async def died(self) -> NodeDied:
        async with asyncio.timeout(10):
            while not isinstance(found := await self.heard.get(), NodeDied):
                pass
            return found

    async def report(self, interface: str) -> Report:
        """The next report about an interface of the environment, by its tag."""
        async with asyncio.timeout(10):
            while not isinstance(found := await self.heard.get(), Report) or found.interface != interface:
                pass
            return found

    async def interface(self, kind: str, type: str, addr: str, qos: Qos | None = None) -> Robot:
        return await self.connect(await self.bind(kind, type, addr, qos))


@asynccontextmanager
async def driven(
    reactor: ReactorBase, directory: Path, **more: str
) -> AsyncIterator[tuple[FakeMaster, asyncio.subprocess.Process]]:
    """A Master and an Environment endpoint that has joined it, which is ended unless the test has done so."""
    master = FakeMaster(DataPort())
    master.listening = await control.listen(reactor, "tcp:0:interface=127.0.0.1", master)
    port = master.listening.getHost().port  # type: ignore[misc]  # zope declares it without self
    settings = {
        "name": NAME,
        "run": RUN,
        "token": "token",
        "master": f"tcp:127.0.0.1:{port}",
        "data_dir": str(directory),
        "package_path": str(PACKAGES),
        **more,
    }
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", "endpoints.environment"),
        env={
            **os.environ,
            **{f"RCE_{key.upper()}": value for key, value in settings.items()},
            "HOME": str(directory / "home"),
            "ROS_DOMAIN_ID": str(domain("environment")),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        },
        cwd=directory,
    )
    try:
        await asyncio.wait_for(asyncio.shield(master.joined), 20)
        yield master, process
    finally:
        if process.returncode is None:
            process.terminate()
        await asyncio.wait_for(process.wait(), 10)
        await master.close()
