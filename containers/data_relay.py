"""Data relay of a machine, through which the data links of its environments pass, as they have no network.

Callers from other machines connect by TCP and name an environment (rce/net/relay_handshake.py); the relay connects them
to the socket on which that environment accepts links. An environment calls one on another machine through its *gate*, a
socket of this relay in a directory that only this environment sees. By the gate the relay knows which environment
calls, whatever the caller claims: it connects it only to environments of its own user, and only by relays that the
Master named.

The relay does not decide which links are admitted. The endpoints do, by their greeting with the Master's one-time key,
which passes through here.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Collection, Coroutine
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from twisted.logger import Logger

from rce.errors import InvalidRequest
from rce.net.relay_handshake import MAX_REQUEST_LENGTH, RefusalReason, RelayRequest, encode_refusal
from rce.net.sockets import advertised_host, bind_unix_socket, parse_host_port, tune, unix_socket_path
from rce.net.tls import PLAINTEXT_WARNING, Tls, is_exposed
from rce.process import metrics

log = Logger()
GATE = "relay.sock"
MAX_LINKS = 256  # of one environment through this relay
MAX_PENDING = 64  # callers whose links are not yet established
TIMEOUT = 5.0  # seconds for the request, and for the onward connection; less than a caller waits for the greeting
MAX_EARLY = 1_000_000  # bytes received before the onward connection is established
HIGH_WATER = 512 * 1024  # bytes buffered for one side from which on the other is paused
_buffer = memoryview(bytearray(256 * 1024))  # shared by all connections, as received data is copied at once


_passed = metrics.Counter("rce_relay_bytes", "Bytes of data links that passed this relay")
_refusals = metrics.Counter("rce_relay_refusals", "Callers that this relay refused", "reason")


class _Refused(Exception):
    """A caller is refused."""

    def __init__(self, reason: RefusalReason) -> None:
        super().__init__(reason)
        self.reason = reason


class _Connection(asyncio.BufferedProtocol):
    """One of two connections that are joined: what is received on one is sent on the other."""

    def __init__(self) -> None:
        self.transport: asyncio.Transport
        self.early = b""  # data received before the connections were joined
        self._other: _Connection | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Set buffer limits and socket options."""
        self.transport = cast(asyncio.Transport, transport)
        self.transport.set_write_buffer_limits(high=HIGH_WATER)
        tune(transport)

    def get_buffer(self, sizehint: int) -> memoryview:
        """Return the buffer to read into."""
        return _buffer

    def buffer_updated(self, nbytes: int) -> None:
        """Handle data that was read into the buffer."""
        self.received(bytes(_buffer[:nbytes]))

    def received(self, data: bytes) -> None:
        """Send data on the other connection, or keep it until there is one."""
        if self._other is not None:
            _passed.add(by=len(data))
            self._other.transport.write(data)
        elif len(self.early) + len(data) <= MAX_EARLY:
            self.early += data
        else:
            self.transport.abort()

    def pause_writing(self) -> None:
        """Pause the other connection while the peer of this one does not read (back-pressure)."""
        if self._other is not None and not self._other.transport.is_closing():
            self._other.transport.pause_reading()

    def resume_writing(self) -> None:
        """Resume the other connection."""
        if self._other is not None and not self._other.transport.is_closing():
            self._other.transport.resume_reading()

    def connection_lost(self, exc: Exception | None) -> None:
        """Close the other connection after its buffered data has been sent."""
        if self._other is not None:
            self._other.transport.close()

    def join(self, other: _Connection) -> None:
        """Send everything received from now on, and before, on another connection."""
        self._other = other
        self.transport.resume_reading()
        _passed.add(by=len(self.early))
        other.transport.write(self.early)
        self.early = b""


class _Caller(_Connection):
    """Connection of a caller, either an environment at its gate or a peer that connected by TCP."""

    def __init__(self, relay: DataRelay, environment: str) -> None:
        """Accept a caller; `environment` is the one whose gate it connected to, empty for TCP."""
        super().__init__()
        self.environment = environment
        self._relay = relay
        self._has_request = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Wait for the request."""
        super().connection_made(transport)
        self._relay.caller_connected(self)

    def received(self, data: bytes) -> None:
        """Read the request from the first line, then pause until the onward connection is established."""
        super().received(data)
        line, newline, rest = self.early.partition(b"\n")
        if self._has_request or not (newline or len(line) > MAX_REQUEST_LENGTH):
            return
        self._has_request = True
        self.early = rest
        self.transport.pause_reading()
        self._relay.request_received(self, line)

    def connection_lost(self, exc: Exception | None) -> None:
        """Close the onward connection too."""
        super().connection_lost(exc)
        self._relay.caller_disconnected(self)

    def refuse(self, reason: RefusalReason) -> None:
        """Send the reason and close the connection."""
        _refusals.add(reason)
        self.transport.write(encode_refusal(reason))
        self.transport.close()


@dataclass
class _Environment:
    """An environment of this machine; `socket` is the one on which it accepts links."""

    socket: Path
    gate: asyncio.Server


class DataRelay:
    """Relays data links between environments of this machine and other machines.

    `tls` authenticates machines to each other; without it the network between them must be trusted.
    """

    def __init__(self, tls: Tls | None = None) -> None:
        self.address = ""  # relay:HOST:PORT as other machines dial it, empty while not listening
        self._relays: frozenset[str] = frozenset()
        self._tls = tls
        self._environments: dict[str, _Environment] = {}
        self._server: asyncio.Server | None = None
        self._links: Counter[str] = Counter()  # by environment
        self._pending: dict[_Caller, asyncio.TimerHandle] = {}
        self._counted: dict[_Caller, str] = {}  # the environment for which the link counts
        self._tasks: set[asyncio.Task[None]] = set()

    async def listen(self, host: str, port: int, address: str = "") -> None:
        """Accept callers from other machines, which dial `address` or else `host`.

        Raises:
            OSError: The address cannot be used.
            InvalidRequest: `host` stands for all addresses, so other machines cannot dial it, and `address` is empty.
        """
        dialled = advertised_host(host, address)
        loop = asyncio.get_running_loop()
        if is_exposed(host, self._tls):
            log.warn(PLAINTEXT_WARNING, what="data", host=host)
        context = self._tls.server if self._tls else None
        self._server = await loop.create_server(lambda: _Caller(self, ""), host, port, ssl=context)
        bound = self._server.sockets[0].getsockname()[1]
        self.address = f"relay:{dialled}:{bound}"
        log.info("accepting data links for environments of this machine at {host}:{port}", host=host, port=bound)

    def set_relays(self, relays: Collection[str]) -> None:
        """Set the relays of other machines, HOST:PORT, to which environments here may be connected."""
        self._relays = frozenset(relays)

    async def add_environment(self, name: str, socket: Path, directory: Path) -> None:
        """Serve an environment that accepts links at `socket`; open its gate in `directory`.

        Raises:
            OSError: The gate cannot be opened.
        """
        # The environment may run as any user; no other environment sees the directory.
        gate = bind_unix_socket(directory / GATE, 0o666)
        self.remove_environment(name)
        server = await asyncio.get_running_loop().create_unix_server(lambda: _Caller(self, name), sock=gate)
        self._environments[name] = _Environment(socket, server)

    def remove_environment(self, name: str) -> None:
        """Stop serving an environment and close its links."""
        environment = self._environments.pop(name, None)
        if environment is None:
            return
        environment.gate.close()
        for caller in [caller for caller, counted in self._counted.items() if counted == name]:
            caller.transport.abort()

    async def close(self) -> None:
        """Stop listening and close all links."""
        for server in (self._server, *(environment.gate for environment in self._environments.values())):
            if server is not None:
                server.close()
        for caller in [*self._pending, *self._counted]:
            caller.transport.abort()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def families(self) -> list[metrics.Family]:
        """Return the metrics of the relay's connections."""
        states: dict[tuple[str, ...], float] = {("asking",): len(self._pending), ("taken",): len(self._counted)}
        return [
            metrics.gauge_family(
                "rce_relay_connections", "Data links through this relay, pending and established", ["state"], states
            )
        ]

    # --- called by the connections of callers -------------------------------------------------------------------------

    def caller_connected(self, caller: _Caller) -> None:
        """Give a caller time for its request, or refuse it if too many are pending."""
        if len(self._pending) >= MAX_PENDING:
            caller.refuse("too many links")
            return
        self._watch(caller)
        timer = asyncio.get_running_loop().call_later(2 * TIMEOUT, caller.transport.abort)
        self._pending[caller] = timer

    def request_received(self, caller: _Caller, line: bytes) -> None:
        """Establish the onward connection that a caller requests."""
        if caller in self._pending:
            self._spawn(self._connect(caller, line))

    def caller_disconnected(self, caller: _Caller) -> None:
        """Forget a caller."""
        timer = self._pending.pop(caller, None)
        if timer is not None:
            timer.cancel()
        counted = self._counted.pop(caller, None)
        if counted is not None:
            self._links[counted] -= 1
            if not self._links[counted]:
                del self._links[counted]

    # --- onward connections -------------------------------------------------------------------------------------------

    async def _connect(self, caller: _Caller, line: bytes) -> None:
        try:
            onward = await self._onward(caller, line)
        except _Refused as error:
            source = caller.environment or "a caller from another machine"
            log.warn("{source} was refused: {reason}: {line}", source=source, reason=error.reason, line=line[:200])
            caller.refuse(error.reason)
            return
        if caller not in self._pending:
            onward.transport.abort()  # the caller has disconnected, or its environment was removed
            return
        self._pending.pop(caller).cancel()
        caller.join(onward)
        onward.join(caller)

    def _count(self, caller: _Caller, name: str) -> None:
        if name not in self._environments:
            raise _Refused("not here")
        if self._links[name] >= MAX_LINKS:
            raise _Refused("too many links")
        self._counted[caller] = name
        self._links[name] += 1

    async def _onward(self, caller: _Caller, line: bytes) -> _Connection:
        try:
            request = RelayRequest.parse(line)
        except InvalidRequest:
            raise _Refused("not understood") from None
        user = caller.environment.partition("/")[0] or request.user
        if user and user != request.to.partition("/")[0]:
            raise _Refused("another user's")
        self._count(caller, caller.environment or request.to)
        try:
            async with asyncio.timeout(TIMEOUT):
                if caller.environment:
                    return await self._to_relay(request, user)
                return await self._to_environment(request.to)
        except (OSError, TimeoutError, ValueError) as error:
            log.info("{to} cannot be reached: {error}", to=request.to, error=str(error) or "timeout")
            raise _Refused("out of reach") from None

    async def _to_environment(self, name: str) -> _Connection:
        with unix_socket_path(self._environments[name].socket) as path:
            _, connection = await asyncio.get_running_loop().create_unix_connection(_Connection, path)
        return connection

    async def _to_relay(self, request: RelayRequest, user: str) -> _Connection:
        if request.relay not in self._relays:
            raise _Refused("no such relay")
        host, port = parse_host_port(request.relay)
        context = self._tls.client if self._tls else None
        _, connection = await asyncio.get_running_loop().create_connection(_Connection, host, port, ssl=context)
        self._watch(connection)
        connection.transport.write(RelayRequest(request.to, user=user).line())
        return connection

    def _watch(self, connection: _Connection) -> None:
        if self._tls is not None:
            self._tls.watch(connection.transport)

    def _spawn(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._finished)

    def _finished(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.error("defect in the data relay: {error!r}", error=error)
