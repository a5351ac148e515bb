"""The data relay of a machine: the way in and out for data links of its environments, which have no network.

From other machines callers come over TCP and name an environment (rce/passage.py); the relay connects them to the
socket at which that environment takes links. An environment that calls one on another machine finds a *gate* in a
directory of its own, a socket of this relay, so that the relay knows who it is, whatever it says: it is taken to
environments of its own user only, and only by way of the relays that the Master named.

Whom a link admits is the endpoints' to judge: their greeting, with the Master's one-time key, passes through here.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Collection, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from twisted.logger import Logger

from rce import metrics
from rce.errors import InvalidRequest
from rce.passage import LONGEST, Passage, Reason, refusal
from rce.sockets import advertised, bound, reaching, split, tune
from rce.tls import PLAIN, Tls, exposed

log = Logger()
GATE = "relay.sock"
LINKS = 256  # through this relay, of one environment
STRANGERS = 64  # connections at a time that have not yet said where they lead
PATIENCE = 5.0  # seconds for the first line, and for the way on; less than the caller's own patience
EARLY = 1_000_000  # bytes
_space = memoryview(bytearray(256 * 1024))  # for all connections: what is read into it is taken at once
HIGH_WATER = 512 * 1024  # bytes that wait for one side before the other is asked to pause


_passed = metrics.Counter("rce_relay_bytes", "Bytes of data links that passed this relay")
_refusals = metrics.Counter("rce_relay_refusals", "Callers of this relay that were not taken on", "reason")


class _Refused(Exception):
    """This caller is not taken on."""

    def __init__(self, reason: Reason) -> None:
        super().__init__(reason)
        self.reason = reason


class _Side(asyncio.BufferedProtocol):
    """One of two connections: what comes in here goes out at the other."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport
        self.early = b""  # what came before the other was there
        self._other: _Side | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(high=HIGH_WATER)
        tune(transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        return _space

    def buffer_updated(self, nbytes: int) -> None:
        self.received(bytes(_space[:nbytes]))

    def received(self, data: bytes) -> None:
        if self._other is not None:
            _passed.add(by=len(data))
            self._other.transport.write(data)
        elif len(self.early) + len(data) <= EARLY:
            self.early += data
        else:
            self.transport.abort()

    def pause_writing(self) -> None:
        if self._other is not None and not self._other.transport.is_closing():
            self._other.transport.pause_reading()

    def resume_writing(self) -> None:
        if self._other is not None and not self._other.transport.is_closing():
            self._other.transport.resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._other is not None:
            self._other.transport.close()  # after what still waits for it

    def lead_to(self, other: _Side) -> None:
        self._other = other
        self.transport.resume_reading()
        _passed.add(by=len(self.early))
        other.transport.write(self.early)
        self.early = b""


class _Visitor(_Side):
    """The side of the caller: an environment at its gate, or somebody who came over TCP."""

    def __init__(self, relay: DataRelay, caller: str) -> None:
        """`caller` is the environment, or empty."""
        super().__init__()
        self.caller = caller
        self._relay = relay
        self._said = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._relay.entered(self)

    def received(self, data: bytes) -> None:
        super().received(data)
        line, newline, rest = self.early.partition(b"\n")
        if self._said or not (newline or len(line) > LONGEST):
            return
        self._said = True
        self.early = rest
        self.transport.pause_reading()
        self._relay.asked(self, line)

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._relay.left(self)

    def refuse(self, reason: Reason) -> None:
        _refusals.add(reason)
        self.transport.write(refusal(reason))
        self.transport.close()


@dataclass
class _Place:
    """An environment of this machine."""

    socket: Path
    gate: asyncio.Server


class DataRelay:
    """`tls` proves machines to each other; without it the network between them must be trusted."""

    def __init__(self, tls: Tls | None = None) -> None:
        self.address = ""  # where others reach it, as the Master is told: relay:HOST:PORT
        self._relays: frozenset[str] = frozenset()
        self._tls = tls
        self._places: dict[str, _Place] = {}
        self._server: asyncio.Server | None = None
        self._links: Counter[str] = Counter()  # by environment
        self._strangers: dict[_Visitor, asyncio.TimerHandle] = {}
        self._guests: dict[_Visitor, str] = {}  # whose link it is counted for
        self._tasks: set[asyncio.Task[None]] = set()

    async def listen(self, host: str, port: int, address: str = "") -> None:
        """Take callers from other machines, who dial `address` or else `host`. Raises OSError, InvalidRequest."""
        dialled = advertised(host, address)
        loop = asyncio.get_running_loop()
        if exposed(host, self._tls):
            log.warn(PLAIN, what="data", host=host)
        context = self._tls.server if self._tls else None
        self._server = await loop.create_server(lambda: _Visitor(self, ""), host, port, ssl=context)
        taken = self._server.sockets[0].getsockname()[1]
        self.address = f"relay:{dialled}:{taken}"
        log.info("data links for environments here are taken at {host}:{port}", host=host, port=taken)

    def know(self, relays: Collection[str]) -> None:
        """The relays of other machines, HOST:PORT, to which environments here may be taken."""
        self._relays = frozenset(relays)

    async def admit(self, name: str, socket: Path, directory: Path) -> None:
        """Serve an environment that takes links at `socket`; its gate is opened in `directory`. Raises OSError."""
        gate = bound(directory / GATE, 0o666)  # it may run as any user; whoever sees the directory is this environment
        self.dismiss(name)
        server = await asyncio.get_running_loop().create_unix_server(lambda: _Visitor(self, name), sock=gate)
        self._places[name] = _Place(socket, server)

    def dismiss(self, name: str) -> None:
        """Serve an environment no more."""
        place = self._places.pop(name, None)
        if place is None:
            return
        place.gate.close()
        for visitor in [visitor for visitor, of in self._guests.items() if of == name]:
            visitor.transport.abort()

    async def close(self) -> None:
        """Take nobody any more, and end what passes through."""
        for server in (self._server, *(place.gate for place in self._places.values())):
            if server is not None:
                server.close()
        for visitor in [*self._strangers, *self._guests]:
            visitor.transport.abort()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def families(self) -> list[metrics.Family]:
        states: dict[tuple[str, ...], float] = {("asking",): len(self._strangers), ("taken",): len(self._guests)}
        return [metrics.gauge("rce_relay_connections", "Data links that pass this relay, or ask to", ["state"], states)]

    # --- for visitors -------------------------------------------------------------------------------------------------

    def entered(self, visitor: _Visitor) -> None:
        if len(self._strangers) >= STRANGERS:
            visitor.refuse("too many links")
            return
        timer = asyncio.get_running_loop().call_later(2 * PATIENCE, visitor.transport.abort)
        self._strangers[visitor] = timer

    def asked(self, visitor: _Visitor, line: bytes) -> None:
        if visitor in self._strangers:
            self._spawn(self._take_on(visitor, line))

    def left(self, visitor: _Visitor) -> None:
        timer = self._strangers.pop(visitor, None)
        if timer is not None:
            timer.cancel()
        counted = self._guests.pop(visitor, None)
        if counted is not None:
            self._links[counted] -= 1
            if not self._links[counted]:
                del self._links[counted]

    # --- the way on ---------------------------------------------------------------------------------------------------

    async def _take_on(self, visitor: _Visitor, line: bytes) -> None:
        try:
            side = await self._onward(visitor, line)
        except _Refused as error:
            whose = visitor.caller or "a caller from another machine"
            log.warn("{whose} was refused: {reason}: {line}", whose=whose, reason=error.reason, line=line[:200])
            visitor.refuse(error.reason)
            return
        if visitor not in self._strangers:
            side.transport.abort()  # it is gone, or its environment
            return
        self._strangers.pop(visitor).cancel()
        visitor.lead_to(side)
        side.lead_to(visitor)

    def _count(self, visitor: _Visitor, name: str) -> None:
        if name not in self._places:
            raise _Refused("not here")
        if self._links[name] >= LINKS:
            raise _Refused("too many links")
        self._guests[visitor] = name
        self._links[name] += 1

    async def _onward(self, visitor: _Visitor, line: bytes) -> _Side:
        try:
            passage = Passage.parse(line)
        except InvalidRequest:
            raise _Refused("not understood") from None
        user = visitor.caller.partition("/")[0] or passage.user
        if user and user != passage.to.partition("/")[0]:
            raise _Refused("another user's")
        self._count(visitor, visitor.caller or passage.to)
        try:
            async with asyncio.timeout(PATIENCE):
                if visitor.caller:
                    return await self._to_relay(passage, user)
                return await self._to_environment(passage.to)
        except (OSError, TimeoutError, ValueError) as error:
            log.info("the way to {to} is closed: {error}", to=passage.to, error=str(error) or "no answer")
            raise _Refused("out of reach") from None

    async def _to_environment(self, name: str) -> _Side:
        with reaching(self._places[name].socket) as path:
            _, side = await asyncio.get_running_loop().create_unix_connection(_Side, path)
        return side

    async def _to_relay(self, passage: Passage, user: str) -> _Side:
        if passage.relay not in self._relays:
            raise _Refused("no such relay")
        host, port = split(passage.relay)
        context = self._tls.client if self._tls else None
        _, side = await asyncio.get_running_loop().create_connection(_Side, host, port, ssl=context)
        side.transport.write(Passage(passage.to, user=user).line())
        return side

    def _spawn(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("defect in the data relay: {error!r}", error=error)
