"""Endpoints without robots and ROS 2: they join the Master, do at once what it asks, and count what nobody sends.

For benches of the Master alone. What an endpoint counts grows ever faster, so that every figure that is shown changes.
"""

from __future__ import annotations

import secrets
import time
from typing import Any

from twisted.internet.base import ReactorBase

from rce import __version__
from rce.calls.call import Call, Nothing, Settled
from rce.calls.endpoints import (
    AddRoute,
    Bind,
    CloseLink,
    DropParameter,
    OpenLink,
    PutParameter,
    RemoveRoute,
    StartNode,
    StopNode,
    Sync,
    Unbind,
)
from rce.calls.joining import Hello
from rce.calls.robots import DropRobot, Tell
from rce.calls.watching import Counts, CountTraffic, InterfaceTraffic, Traffic
from rce.control import Control, Handlers, connect

DONE = (Unbind, OpenLink, CloseLink, RemoveRoute, StartNode, StopNode, PutParameter, DropParameter, Tell, DropRobot)
"""Asked of an endpoint, and done without doing anything."""


async def join(reactor: ReactorBase, master: str, role: str, name: str, token: str, url: str = "") -> Control:
    """A hollow endpoint of this role joins the Master at this control address. Unavailable, or why it is refused."""
    said = Hello(role, name, token, __version__, url=url, addresses=["unix:/hollow"], incarnation=secrets.token_hex(4))
    control, _ = await connect(reactor, master, said, Hollow().handlers())
    return control


class Hollow:
    """What such an endpoint answers; it knows its interfaces, by id, and the peers of each."""

    def __init__(self) -> None:
        self._peers: dict[str, set[str]] = {}
        self._began = time.monotonic()

    def handlers(self) -> Handlers:
        handlers = Handlers()
        for kind in DONE:
            handlers.on(kind, done)
        handlers.on(Sync, _settled)
        handlers.on(Bind, self._bind)
        handlers.on(AddRoute, self._route)
        handlers.on(CountTraffic, self._count)
        return handlers

    async def _bind(self, call: Bind) -> Nothing:
        self._peers[call.interface.id] = set()
        return Nothing()

    async def _route(self, call: AddRoute) -> Nothing:
        self._peers[call.route.interface].add(call.route.peer)
        return Nothing()

    async def _count(self, _: CountTraffic) -> Traffic:
        passed = time.monotonic() - self._began
        each = Counts(int(passed**2), int(1000 * passed**2))
        return Traffic(
            {key: InterfaceTraffic(each, each, dict.fromkeys(peers, each)) for key, peers in self._peers.items()}
        )


async def done(call: Call[Any]) -> Nothing:
    return Nothing()


async def _settled(call: Call[Any]) -> Settled:
    return Settled()
