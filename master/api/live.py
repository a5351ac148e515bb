"""`/api/v1/live`: the graph as it changes, over a WebSocket. Browsers cannot send headers with one, so the key comes in
the first message."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Callable

from master import rights
from master.api.problems import status_of
from master.api.sockets import POLICY, Listener, Socket
from master.audit import Origin
from master.records import user_of
from master.rights import EVERYBODY, NOBODY, Principal
from master.service import Master
from rce.errors import LimitExceeded, RceError, Unauthorized
from rce.messages import decode_as
from rce.views import Greeting, Kind

GREETING = 10.0  # seconds within which it must come
MOST = 20  # watchers of one user
REFUSED = 4000  # plus the HTTP status: the close code of who is refused, as at the robots' door
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


class Live:
    """Makes a watcher of each socket."""

    def __init__(self, master: Master) -> None:
        self.master = master
        self.watching: Counter[str] = Counter()

    def listener(self, socket: Socket) -> Listener:
        return _Watcher(self, socket)


class _Watcher:
    """One socket: nobody until it has said who it is."""

    def __init__(self, live: Live, socket: Socket) -> None:
        self._live = live
        self._socket = socket
        self._principal: Principal | None = None
        self._whose = ""
        self._kinds: frozenset[Kind] = frozenset()
        self._release: Callable[[], None] = lambda: None
        self._has: set[tuple[Kind, str]] = set()  # what one whose key is tied was sent: no more is said of others
        self._admission: asyncio.Task[None] | None = None
        self._patience = asyncio.get_running_loop().call_later(GREETING, self._too_late)

    # --- the socket's ---------------------------------------------------------------------------------------------

    def received(self, text: bytes) -> None:
        if self._admission is not None:
            self._socket.close(POLICY, "nothing is said here after the first message")
            return
        self._patience.cancel()
        self._admission = asyncio.ensure_future(self._admit(text))

    def room(self) -> None:
        if self._principal is not None:
            self._live.master.feed.catch_up(self)

    def closed(self) -> None:
        self._patience.cancel()
        if self._admission is not None:
            self._admission.cancel()
        if self._principal is not None:
            self._live.master.feed.remove(self)
            self._live.watching[self._principal.user] -= 1
            self._release()

    def _void(self, reason: str) -> None:
        self._socket.close(REFUSED + status_of(Unauthorized(reason)), reason)

    def _too_late(self) -> None:
        self._socket.close(POLICY, f"no key within {GREETING:g} s")

    async def _admit(self, text: bytes) -> None:
        try:
            greeting = decode_as(Greeting, text, "greeting")
            if not greeting.key.startswith("rce_"):
                raise Unauthorized("greeting.key: an API key is needed", field="key")
            principal = await self._live.master.users.check("", greeting.key)
            self._begin(principal, greeting)
        except RceError as error:
            self._live.master.audit.note(None, "login", "", "", Origin("live", self._socket.address), error)
            self._socket.close(REFUSED + status_of(error), str(error))

    def _begin(self, principal: Principal, greeting: Greeting) -> None:
        self._whose = greeting.user or principal.user
        if self._whose == EVERYBODY and rights.reach(principal, "feed.read") == "own":
            self._whose = principal.user
        rights.check(principal, "feed.read", self._whose)
        wanted = greeting.kinds or READ
        self._kinds = frozenset(
            kind for kind in wanted if rights.may(principal, READ[kind], NOBODY if kind == "machines" else self._whose)
        )
        if self._live.watching[principal.user] >= MOST:
            raise LimitExceeded(f"{principal.user} has {MOST} watchers already", limit=MOST)
        self._live.watching[principal.user] += 1
        self._principal = principal
        self._release = self._live.master.guard.hold(principal, self._void)
        self._live.master.feed.add(self)

    # --- the feed's -----------------------------------------------------------------------------------------------

    @property
    def free(self) -> bool:
        return not self._socket.full

    def sees(self, kind: Kind, key: str, gone: bool = False) -> bool:
        if kind not in self._kinds:
            return False
        if kind != "machines" and self._whose not in (EVERYBODY, user_of(key)):
            return False
        if self._principal is None or not self._principal.scopes.tied:
            return True
        if gone:
            return (kind, key) in self._has
        seen = all(
            rights.sees(self._principal, self._live.master.state, READ[kind], self._whose, side.split("/")[1])
            for side in key.split(" ")
        )
        if seen:
            self._has.add((kind, key))
        return seen

    def send(self, message: bytes) -> None:
        self._socket.send(message)
