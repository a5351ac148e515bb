"""Master for tests of task sets, which records what they report."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable

from twisted.internet.base import ReactorBase
from twisted.internet.interfaces import IListeningPort

from containers.ports import close_port
from rce.control.calls.call import Nothing
from rce.control.calls.environments import (
    EnvironmentDied,
    LimitReached,
    ReportRelays,
)
from rce.control.calls.joining import Hello, Welcome
from rce.control.connection import Control, Handlers
from rce.control.server import listen
from rce.errors import Unauthorized

WAIT = 60.0  # seconds until a test gives up; programs start slowly on a busy machine


class FakeMaster:
    """Admits task sets with an accepted token or credential, and records their calls.

    Its port stays the same while it is down: a bound socket that does not listen keeps it from other programs.
    """

    def __init__(self, reactor: ReactorBase) -> None:
        self.reactor = reactor
        self.accepted = {"token", "credential"}
        self.hellos: list[Hello] = []
        self.joined: asyncio.Queue[Control] = asyncio.Queue()
        self.deaths: asyncio.Queue[EnvironmentDied] = asyncio.Queue()
        self.limits: asyncio.Queue[LimitReached] = asyncio.Queue()
        self.relays: asyncio.Queue[ReportRelays] = asyncio.Queue()
        self.controls: list[Control] = []
        self._reserved = socket.socket()
        self._reserved.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._reserved.bind(("127.0.0.1", 0))
        self.number: int = self._reserved.getsockname()[1]
        self._port: IListeningPort | None = None

    async def up(self) -> None:
        self._port = await listen(self.reactor, f"tcp:{self.number}:interface=127.0.0.1", self)

    async def down(self) -> None:
        if self._port is not None:
            await close_port(self._port)
            self._port = None
        for control in self.controls:
            control.close()
            await control.lost
        self.controls.clear()

    async def close(self) -> None:
        await self.down()
        self._reserved.close()

    async def join(self, hello: Hello, address: str) -> tuple[Welcome, Handlers, Callable[[Control], None]]:
        self.hellos.append(hello)
        if hello.token not in self.accepted:
            raise Unauthorized(f"{hello.name}: this token is not known")
        handlers = Handlers()
        handlers.on(EnvironmentDied, self._died)
        handlers.on(LimitReached, self._limit)
        handlers.do(ReportRelays, self.relays.put_nowait)
        return Welcome("credential"), handlers, self._joined

    def _joined(self, control: Control) -> None:
        self.controls.append(control)
        self.joined.put_nowait(control)

    async def _limit(self, call: LimitReached) -> Nothing:
        self.limits.put_nowait(call)
        return Nothing()

    async def _died(self, call: EnvironmentDied) -> Nothing:
        self.deaths.put_nowait(call)
        return Nothing()


async def joined(master: FakeMaster) -> Control:
    return await asyncio.wait_for(master.joined.get(), WAIT)
