"""Who a client is, by the credentials that open all of the platform; the Master checks them."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from msgspec import Struct
from twisted.logger import Logger

from rce.calls.call import Call
from rce.calls.services import Borrow, Delegate, EndGrant, LentKey, NoteDone, Person, Vouch
from rce.errors import RceError, Unauthorized

REMEMBER = 30.0  # seconds for which a proof is good, so that a stream of requests is not a stream of argon2 checks
MOST = 10_000  # proofs that are remembered
KEY_PREFIX = "rce_"

log = Logger()


class Master(Protocol):
    """The control connection."""

    @property
    def connected(self) -> bool: ...

    async def call(self, call: Call[Any], wait: float = ...) -> Any: ...


class Client(Struct, frozen=True):
    """A user, and the secret by which they proved it: never kept on disk."""

    user: str
    secret: str
    person: Person


class Access:
    """Asks the Master, and remembers what it said for a while."""

    def __init__(self, master: Callable[[], Master], now: Callable[[], float] = time.monotonic) -> None:
        self._master = master
        self._now = now
        self._known: dict[bytes, tuple[Person, float]] = {}
        self._asked: dict[bytes, asyncio.Task[Person]] = {}
        self._notes: set[asyncio.Task[None]] = set()
        self._doubts: dict[str, asyncio.Future[None]] = {}

    @property
    def reachable(self) -> bool:
        """Whether the Master is there."""
        return self._master().connected

    async def client(
        self, headers: Mapping[str, str], query: Mapping[str, str], operation: str = "job.submit", address: str = ""
    ) -> Client:
        """Who it is, if they may. Unauthorized, TooManyAttempts, Forbidden, Unavailable (the Master is away)."""
        user, secret = credentials(headers, query)
        mark = hashlib.sha256(f"{operation}\n{user}\n{secret}".encode()).digest()
        known = self._known.get(mark)
        if known is not None and known[1] > self._now():
            return Client(known[0].user, secret, known[0])
        if mark not in self._asked:  # many requests at once are one question
            self._asked[mark] = asyncio.create_task(self._ask(mark, Vouch(user, secret, operation, address)))
        person = await asyncio.shield(self._asked[mark])
        return Client(person.user, secret, person)

    async def _ask(self, mark: bytes, question: Vouch) -> Person:
        try:
            person: Person = await self._master().call(question)
        finally:
            self._asked.pop(mark, None)
        if len(self._known) >= MOST:
            self._known.clear()
        self._known[mark] = (person, self._now() + REMEMBER)
        return person

    def forget(self, user: str) -> None:
        """What this user proved is to be proved again."""
        self._known = {mark: known for mark, known in self._known.items() if known[0].user != user}
        doubt = self._doubts.pop(user, None)
        if doubt is not None:
            doubt.set_result(None)

    def doubt(self, user: str) -> asyncio.Future[None]:
        """Done when this user's proofs are forgotten: what goes on for long asks anew then."""
        if user not in self._doubts:
            self._doubts[user] = asyncio.get_running_loop().create_future()
        return self._doubts[user]

    def note(self, client: Client, action: str, thing: str, result: str, address: str) -> None:
        """Tell the Master what a client did; nobody waits for that."""
        task = asyncio.create_task(self._note(NoteDone(client.person, action, thing, result, address)))
        self._notes.add(task)
        task.add_done_callback(self._notes.discard)

    async def _note(self, note: NoteDone) -> None:
        try:
            await self._master().call(note)
        except RceError as error:
            log.warn("not in the audit log: {note}: {error}", note=note, error=str(error))

    async def delegate(self, user: str, secret: str) -> str:
        return str((await self._master().call(Delegate(user, secret))).grant)

    async def borrow(self, grant: str, seconds: float) -> LentKey:
        lent: LentKey = await self._master().call(Borrow(grant, seconds))
        return lent

    async def end(self, grant: str) -> None:
        await self._master().call(EndGrant(grant), wait=60.0)


def credentials(headers: Mapping[str, str], query: Mapping[str, str]) -> tuple[str, str]:
    """The user, who may be left out with an API key, and the API key or the SHA-256 of the password. Unauthorized.

    `Authorization: Bearer KEY`, `Authorization: Basic` with a key or the password, or, as at the robots' entry,
    `userID` with `key` or `password` (its SHA-256) in the query.
    """
    scheme, _, rest = headers.get("Authorization", "").partition(" ")
    user = query.get("userID", "")
    match scheme.lower():
        case "bearer" if rest.strip():
            return user, rest.strip()
        case "basic":
            try:
                name, _, secret = base64.b64decode(rest, validate=True).decode().partition(":")
            except ValueError:
                raise Unauthorized("Authorization: Basic is not base64 of user:password") from None
            return name, secret if secret.startswith(KEY_PREFIX) else hashlib.sha256(secret.encode()).hexdigest()
    if query.get("key"):
        return user, query["key"]
    if query.get("password") and user:
        return user, query["password"]
    raise Unauthorized(
        "no credentials: send Authorization: Bearer with an API key, Basic with user and password, or userID and key"
    )
