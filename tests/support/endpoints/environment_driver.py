"""Driver of a real Environment endpoint: a Master and a Robot endpoint that the test controls."""

from __future__ import annotations

import asyncio
import os
import secrets
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, TypeVar

from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort

from endpoints.data.frames import Message
from endpoints.data.hops import HopRecorder
from endpoints.data.interface import Interface, error_of
from endpoints.data.link import Link
from endpoints.data.port import DataPort
from endpoints.data.switchboard import Switchboard
from rce.control.calls.call import Call, Nothing
from rce.control.calls.endpoints import (
    AddRoute,
    Bind,
    InterfaceSpec,
    Launched,
    LinkLost,
    LinkSpec,
    NodeDied,
    OpenLink,
    Report,
    Route,
)
from rce.control.calls.joining import Hello, Welcome
from rce.control.calls.watching import ReadLog
from rce.control.connection import Control, Handlers
from rce.control.server import listen
from rce.errors import Unauthorized
from rce.protocol.messages import Qos
from tests.support.domains import domain
from tests.support.paths import TESTS

NAME = "user/env"
RUN = "ab" * 16
LIMIT = 60.0  # seconds until a test gives up; nodes start slowly on a busy machine
PACKAGES = TESTS / "endpoints" / "environment" / "packages"
R = TypeVar("R")


class Robot(Interface):
    """Interface that collects the messages that it receives."""

    def __init__(self, spec: InterfaceSpec, hops: HopRecorder) -> None:
        super().__init__(spec, hops)
        self.received: asyncio.Queue[Message] = asyncio.Queue()
        self.answer: Callable[[Message], Message] | None = None

    def receive(self, message: Message, link: Link) -> None:
        if self.answer is not None:
            self.request(self.answer(message))
        else:
            self.received.put_nowait(message)

    async def next(self) -> bytes:
        """Return the next message; raise the error of an error message."""
        message = await asyncio.wait_for(self.received.get(), LIMIT)
        if message.error:
            raise error_of(message)
        return bytes(message.payload)

    def publish(self, payload: bytes) -> None:
        self.send(Message(self.id, "nil", payload))

    async def call(self, payload: bytes) -> bytes:
        self.request(Message(self.id, secrets.token_hex(16), payload))
        return await self.next()


class FakeMaster:
    """Master of one Environment endpoint; `reports` has the calls of the endpoint."""

    def __init__(self, port: DataPort) -> None:
        self.hello: Hello
        self.reports: asyncio.Queue[Call[Any]] = asyncio.Queue()
        self.refuse = False
        self.socket = Path()  # of the environment, for data links
        self.joined: asyncio.Future[Control] = asyncio.get_running_loop().create_future()
        self.board = Switchboard(port, lambda link, reason: self.reports.put_nowait(LinkLost(link, reason)))
        self.listening: IListeningPort
        self._link = ""

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        if self.refuse:
            raise Unauthorized("replaced")
        self.hello = hello
        handlers = Handlers()
        for kind in (NodeDied, Launched, LinkLost, Report):
            handlers.on(kind, self._add_report)
        if self.joined.done():
            self.joined = asyncio.get_running_loop().create_future()
        return Welcome("credential"), handlers, self.joined.set_result

    async def _add_report(self, call: Call[Any]) -> Nothing:
        self.reports.put_nowait(call)
        return Nothing()

    async def call(self, call: Call[R]) -> R:
        return await (await asyncio.wait_for(asyncio.shield(self.joined), LIMIT)).call(call)

    async def link(self) -> str:
        """Return the name of the link to the environment, opened at the first call."""
        if not self._link:
            await asyncio.shield(self.joined)
            self._link, key = "link", secrets.token_hex(16)
            await self.call(OpenLink(LinkSpec(self._link, key)))
            self.board.open_link(LinkSpec(self._link, key, [f"unix:{self.socket}"]))
        return self._link

    async def bind(self, kind: str, type: str, addr: str, qos: Qos | None = None) -> InterfaceSpec:
        """Bind an interface of the environment."""
        spec = InterfaceSpec(secrets.token_hex(16), NAME, f"tag{secrets.token_hex(4)}", kind, type, addr, qos or Qos())
        await self.call(Bind(spec))
        return spec

    async def connect(self, there: InterfaceSpec) -> Robot:
        """Return a robot's interface that is connected to one of the environment."""
        robots: list[Robot] = []

        async def make(spec: InterfaceSpec) -> Robot:
            robots.append(Robot(spec, self.board.hops))
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
        """Return the next report of a node that ended by itself."""
        async with asyncio.timeout(LIMIT):
            while not isinstance(found := await self.reports.get(), NodeDied):
                pass
            return found

    async def launched(self) -> Launched:
        """Return the next report of the nodes of a launch."""
        async with asyncio.timeout(LIMIT):
            while not isinstance(found := await self.reports.get(), Launched):
                pass
            return found

    async def report(self, interface: str) -> Report:
        """Return the next report about an interface of the environment, given its tag."""
        async with asyncio.timeout(LIMIT):
            while not isinstance(found := await self.reports.get(), Report) or found.interface != interface:
                pass
            return found

    async def interface(self, kind: str, type: str, addr: str, qos: Qos | None = None) -> Robot:
        """Bind an interface of the environment; return a robot's interface that is connected to it."""
        return await self.connect(await self.bind(kind, type, addr, qos))


async def wait_for_line(master: FakeMaster, tag: str, text: str) -> str:
    """Return the last complete line of a node's output that contains `text`, once there is one."""
    position = "beginning"
    async with asyncio.timeout(LIMIT):
        while True:
            log = await master.call(ReadLog(tag, after=position, wait=1))
            found = [line for line in log.lines if text in line]
            if found:
                return found[-1]
            position = log.next


def is_alive(pid: int) -> bool:
    """Return True if a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@asynccontextmanager
async def driven(
    reactor: ReactorBase, directory: Path, **more: str
) -> AsyncIterator[tuple[FakeMaster, asyncio.subprocess.Process]]:
    """Run a Master and an Environment endpoint that has joined it; stop the endpoint unless the test has done so."""
    master = FakeMaster(DataPort())
    master.socket = directory / "data.sock"
    master.listening = await listen(reactor, "tcp:0:interface=127.0.0.1", master)
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
        await asyncio.wait_for(asyncio.shield(master.joined), LIMIT)
        yield master, process
    finally:
        if process.returncode is None:
            process.terminate()
        await asyncio.wait_for(process.wait(), LIMIT)
        await master.close()
