"""`/api/v1/live`: changes of the graph over a WebSocket.

Browsers cannot send headers with a WebSocket's handshake, so the API key comes in the first message.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections import Counter, deque
from collections.abc import Iterator
from typing import Any, NamedTuple

from aiohttp import WSCloseCode, WSMsgType, web

from master.access import rights
from master.access.audit import Origin
from master.access.rights import EVERYBODY, NOBODY, Principal
from master.graph.records import user_of
from master.service import Master
from rce.api.views import Greeting, Kind
from rce.errors import InvalidRequest, LimitExceeded, RceError, Unauthorized
from rce.protocol.messages import decode_as
from rce.web.problems import UpgradeRequired, problem_response, status_of
from rce.web.requests import header, peer_address

GREETING_TIMEOUT = 10.0  # seconds
PING_INTERVAL = 20.0  # seconds; a client that does not answer a ping within half of this is gone
CLOSE_TIMEOUT = 1.0  # seconds for the client's side of the closing handshake; a stopping Master waits that long
MAX_MESSAGE = 65_536  # bytes from a client
MAX_WATCHERS = 20  # of one user
MAX_REASON = 120  # bytes of the reason in a close frame
GOING_AWAY, POLICY_VIOLATION = WSCloseCode.GOING_AWAY, WSCloseCode.POLICY_VIOLATION
ERROR_CODES = 4000  # plus the HTTP status of an error: its close code, as at the Robot endpoints
READ: dict[Kind, str] = {
    "robots": "robot.read",
    "environments": "environment.read",
    "nodes": "node.read",
    "parameters": "parameter.read",
    "interfaces": "interface.read",
    "connections": "connection.read",
    "groups": "group.read",
    "machines": "machine.read",
}


class Close(NamedTuple):
    """Close code and reason of a WebSocket."""

    code: int
    reason: str


class LiveFeed:
    """WebSockets that watch the graph."""

    def __init__(self, master: Master) -> None:
        self.master = master
        self.watching: Counter[str] = Counter()
        self._watchers: dict[_Watcher, asyncio.Task[Any]] = {}

    async def handle(self, request: web.BaseRequest) -> web.StreamResponse:
        """Serve a WebSocket until it is closed; any other request is refused."""
        if "websocket" not in (header(request, "Upgrade") or "").lower() or request.method != "GET":
            message = "this is for WebSockets: connect with ws:// or wss://"
            return problem_response(UpgradeRequired(message, headers={"Upgrade": "websocket"}))
        socket = web.WebSocketResponse(
            timeout=CLOSE_TIMEOUT,
            heartbeat=PING_INTERVAL,
            compress=False,
            max_msg_size=MAX_MESSAGE + 1,  # the first size that aiohttp refuses
        )
        try:
            await socket.prepare(request)
        except (web.HTTPException, ValueError) as error:  # of aiohttp; of a key that is not ASCII
            return problem_response(InvalidRequest(f"WebSocket handshake: {getattr(error, 'text', None) or error}"))
        watcher = _Watcher(self, socket, peer_address(request))
        task = asyncio.current_task()
        assert task is not None
        self._watchers[watcher] = task
        try:
            await _close(socket, request.transport, await watcher.run())
        finally:
            del self._watchers[watcher]
        return socket

    async def stop(self) -> None:
        """Close all WebSockets: the server stops."""
        for watcher in self._watchers:
            watcher.close(Close(GOING_AWAY, "the Master stops"))
        if self._watchers:
            await asyncio.wait(self._watchers.values(), timeout=2 * CLOSE_TIMEOUT)


async def _close(socket: web.WebSocketResponse, transport: asyncio.Transport | None, close: Close) -> None:
    reason = close.reason.encode()[:MAX_REASON].decode(errors="ignore").encode()
    with contextlib.suppress(TimeoutError, ConnectionError):
        async with asyncio.timeout(CLOSE_TIMEOUT):
            await socket.close(code=close.code, message=reason)
    if transport is not None and socket.close_code in (None, WSCloseCode.ABNORMAL_CLOSURE):
        transport.abort()  # what the client does not read would keep the connection open


class _Watcher:
    """One WebSocket, and its view of the feed once its greeting was accepted."""

    def __init__(self, live: LiveFeed, socket: web.WebSocketResponse, address: str) -> None:
        self._live = live
        self._socket = socket
        self._address = address
        self._closing: asyncio.Future[Close] = asyncio.get_running_loop().create_future()
        self._outgoing: deque[bytes] = deque()
        self._queued = asyncio.Event()
        self._principal: Principal | None = None
        self._owner = ""
        self._kinds: frozenset[Kind] = frozenset()
        self._announced: set[tuple[Kind, str]] = set()  # sent to a restricted key: it is told when these are gone

    def close(self, close: Close) -> None:
        """Have `run` end."""
        if not self._closing.done():
            self._closing.set_result(close)

    async def run(self) -> Close:
        """Serve the WebSocket until it is to be closed, and return how."""
        tasks = [asyncio.ensure_future(self._receive()), asyncio.ensure_future(self._send_outgoing())]
        with contextlib.ExitStack() as self._resources:
            try:
                await asyncio.wait([self._closing, *tasks], return_when=asyncio.FIRST_COMPLETED)
            finally:
                for task in tasks:
                    task.cancel()
        await asyncio.wait(tasks)
        for task in tasks:
            if not task.cancelled():
                self.close(task.result())
        return self._closing.result()

    async def _receive(self) -> Close:
        """Admit the client by its greeting, which is the only message that it may send."""
        try:
            async with asyncio.timeout(GREETING_TIMEOUT):
                message = await self._socket.receive()
        except TimeoutError:
            return Close(POLICY_VIOLATION, f"no greeting with an API key within {GREETING_TIMEOUT:g} s")
        if message.type is not WSMsgType.TEXT:
            return Close(POLICY_VIOLATION, "the greeting must be a text message")
        try:
            await self._admit(message.data)
        except RceError as error:
            self._live.master.audit.note(None, "login", "", "", Origin("live", self._address), error)
            return Close(ERROR_CODES + status_of(error), str(error))
        await self._socket.receive()
        return Close(POLICY_VIOLATION, "no message is taken after the greeting")

    async def _admit(self, text: str) -> None:
        greeting = decode_as(Greeting, text.encode(), "greeting")
        if not greeting.key.startswith("rce_"):
            raise Unauthorized("greeting.key: an API key is needed", field="key")
        principal = await self._live.master.users.check("", greeting.key)
        self._owner = greeting.user or principal.user
        if self._owner == EVERYBODY and rights.reach(principal, "feed.read") == "own":
            self._owner = principal.user
        rights.check(principal, "feed.read", self._owner)
        self._kinds = frozenset(
            kind
            for kind in greeting.kinds or READ
            if rights.may(principal, READ[kind], NOBODY if kind == "machines" else self._owner)
        )
        if self._live.watching[principal.user] >= MAX_WATCHERS:
            raise LimitExceeded(f"{principal.user} has {MAX_WATCHERS} watchers already", limit=MAX_WATCHERS)
        self._principal = principal
        self._resources.enter_context(self._watching(principal))

    @contextlib.contextmanager
    def _watching(self, principal: Principal) -> Iterator[None]:
        """Take part in the feed, until the credentials are revoked at the latest."""
        master, watching = self._live.master, self._live.watching
        watching[principal.user] += 1
        release = master.guard.hold(principal, self._revoked)
        master.feed.add(self)
        try:
            yield
        finally:
            master.feed.remove(self)
            release()
            watching[principal.user] -= 1

    def _revoked(self, reason: str) -> None:
        self.close(Close(ERROR_CODES + status_of(Unauthorized(reason)), reason))

    async def _send_outgoing(self) -> Close:
        """Send what is queued; returns when the connection is lost."""
        try:
            while True:
                await self._queued.wait()
                while self._outgoing:
                    await self._socket.send_frame(self._outgoing[0], WSMsgType.TEXT)  # waits for a slow client
                    self._outgoing.popleft()
                self._queued.clear()
                self._live.master.feed.catch_up(self)
        except ConnectionError:
            return Close(GOING_AWAY, "the connection was lost")

    # --- what the feed calls ----------------------------------------------------------------------------------------

    @property
    def free(self) -> bool:
        """True if everything has been sent."""
        return not self._outgoing

    def sees(self, kind: Kind, key: str, gone: bool = False) -> bool:
        """Return whether the client may see this, or could before it was gone."""
        if kind not in self._kinds:
            return False
        if kind != "machines" and self._owner not in (EVERYBODY, user_of(key)):
            return False
        if self._principal is None or not self._principal.scopes.tied:
            return True
        if gone:
            return (kind, key) in self._announced
        seen = all(
            rights.sees(self._principal, self._live.master.state, READ[kind], self._owner, side.split("/")[1])
            for side in key.split(" ")
        )
        if seen:
            self._announced.add((kind, key))
        return seen

    def send(self, message: bytes) -> None:
        """Queue a message."""
        self._outgoing.append(message)
        self._queued.set()
