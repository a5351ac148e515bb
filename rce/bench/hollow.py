"""Simulated endpoints without robots and ROS 2, for benchmarks of the Master alone.

They join the Master, answer each call at once, and report traffic that does not exist. The traffic grows ever faster,
so that each number on display changes.
"""

from __future__ import annotations

import secrets
import time
from typing import Any

from twisted.internet.base import ReactorBase

from rce import __version__
from rce.control.calls.call import BatchResult, Call, Nothing
from rce.control.calls.endpoints import (
    AddRoute,
    Bind,
    CloseLink,
    DropParameter,
    OpenLink,
    PutParameter,
    PutSecrets,
    RemoveRoute,
    StartNode,
    StartRecorder,
    StopNode,
    StopRecorder,
    Sync,
    Unbind,
)
from rce.control.calls.joining import Hello
from rce.control.calls.robots import DropRobot, SendStatus
from rce.control.calls.watching import Counts, CountTraffic, InterfaceTraffic, Traffic
from rce.control.client import connect
from rce.control.connection import Control, Handlers

DONE = (
    Unbind,
    OpenLink,
    CloseLink,
    RemoveRoute,
    StartNode,
    StopNode,
    PutParameter,
    PutSecrets,
    DropParameter,
    StartRecorder,
    StopRecorder,
    SendStatus,
    DropRobot,
)
"""Calls that a simulated endpoint answers without any effect."""


async def join(reactor: ReactorBase, master: str, role: str, name: str, token: str, url: str = "") -> Control:
    """Join the Master at a control address as a simulated endpoint.

    Args:
        reactor: Twisted's reactor.
        master: Control address of the Master.
        role: Role of the endpoint.
        name: Name of the endpoint.
        token: Token of the endpoint.
        url: URL that robots connect to, for a robot endpoint.

    Raises:
        Unavailable: The Master does not answer. If it rejects the endpoint, its own error is raised.
    """
    hello = Hello(role, name, token, __version__, url=url, addresses=["unix:/hollow"], incarnation=secrets.token_hex(4))
    control, _ = await connect(reactor, master, hello, Hollow().handlers())
    return control


class Hollow:
    """Handlers of a simulated endpoint, which knows its interfaces and the peers of each."""

    def __init__(self) -> None:
        """Start without interfaces."""
        self._peers: dict[str, set[str]] = {}
        self._started = time.monotonic()

    def handlers(self) -> Handlers:
        """Return the handlers of all calls to the endpoint."""
        handlers = Handlers()
        for kind in DONE:
            handlers.on(kind, done)
        handlers.on(Sync, self._sync)
        handlers.on(Bind, self._bind)
        handlers.on(AddRoute, self._route)
        handlers.on(CountTraffic, self._count)
        return handlers

    async def _sync(self, call: Sync) -> BatchResult:
        self._peers = {spec.id: set() for spec in call.interfaces}
        for route in call.routes:
            self._peers[route.interface].add(route.peer)
        return BatchResult()

    async def _bind(self, call: Bind) -> Nothing:
        self._peers[call.interface.id] = set()
        return Nothing()

    async def _route(self, call: AddRoute) -> Nothing:
        self._peers[call.route.interface].add(call.route.peer)
        return Nothing()

    async def _count(self, _: CountTraffic) -> Traffic:
        elapsed = time.monotonic() - self._started
        each = Counts(int(elapsed**2), int(1000 * elapsed**2))
        return Traffic(
            {key: InterfaceTraffic(each, each, dict.fromkeys(peers, each)) for key, peers in self._peers.items()}
        )


async def done(call: Call[Any]) -> Nothing:
    """Answer a call that has no effect."""
    return Nothing()
