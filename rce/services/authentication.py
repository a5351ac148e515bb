"""Authentication of clients with the credentials of the platform, which the Master checks."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

from msgspec import Struct
from twisted.logger import Logger

from rce.control.calls.call import Call
from rce.control.calls.services import (
    Authenticate,
    CreateGrant,
    Identity,
    IssueKey,
    RecordAction,
    RevokeGrant,
    TemporaryKey,
)
from rce.errors import RceError, Unauthorized

CACHE_TIME = 30.0  # seconds; without a cache, each request would cost the Master an argon2 check
CACHE_SIZE = 10_000
KEY_PREFIX = "rce_"

log = Logger()


class Master(Protocol):
    """Control connection to the Master."""

    @property
    def connected(self) -> bool:
        """True while the service is joined."""

    async def call(self, call: Call[Any], wait: float = ...) -> Any:
        """Call the Master and return its answer."""


class Client(Struct, frozen=True):
    """Authenticated client. The secret that it sent is never stored on disk."""

    user: str
    secret: str
    identity: Identity


class Authenticator:
    """Authenticates clients at the Master, caches the results, and manages the grants to act for users."""

    def __init__(self, master: Callable[[], Master], now: Callable[[], float] = time.monotonic) -> None:
        self._master = master
        self._now = now
        self._cache: dict[bytes, tuple[Identity, float]] = {}  # with the time of expiry
        self._pending: dict[bytes, asyncio.Task[Identity]] = {}
        self._records: set[asyncio.Task[None]] = set()
        self._invalidations: dict[str, asyncio.Future[None]] = {}
        self._invalidated = 0  # number of calls of `invalidate`

    @property
    def reachable(self) -> bool:
        """True while the Master is connected."""
        return self._master().connected

    async def authenticate(
        self, headers: Mapping[str, str], query: Mapping[str, str], operation: str = "job.submit", address: str = ""
    ) -> Client:
        """Authenticate a client and authorize an operation.

        Args:
            headers: Headers of the request.
            query: Query parameters of the request.
            operation: What the client wants to do, such as `job.read` or `knowledge.write`.
            address: Network address of the client, for the audit log.

        Raises:
            Unauthorized: The credentials are missing or wrong.
            TooManyAttempts: There were too many wrong passwords.
            Forbidden: The role of the user does not permit the operation.
            Unavailable: The Master cannot be reached.
        """
        user, secret = credentials(headers, query)
        key = hashlib.sha256(f"{operation}\n{user}\n{secret}".encode()).digest()
        cached = self._cache.get(key)
        if cached is not None and cached[1] > self._now():
            return Client(cached[0].user, secret, cached[0])
        if key not in self._pending:  # simultaneous requests share one call
            self._pending[key] = asyncio.create_task(self._ask(key, Authenticate(user, secret, operation, address)))
        identity = await asyncio.shield(self._pending[key])
        return Client(identity.user, secret, identity)

    async def _ask(self, key: bytes, call: Authenticate) -> Identity:
        invalidated = self._invalidated
        try:
            identity: Identity = await self._master().call(call)
        finally:
            self._pending.pop(key, None)
        if invalidated != self._invalidated:  # the answer may be older than the change of the user
            return identity
        if len(self._cache) >= CACHE_SIZE:
            self._cache.clear()
        self._cache[key] = (identity, self._now() + CACHE_TIME)
        return identity

    def invalidate(self, user: str) -> None:
        """Forget that this user is authenticated."""
        self._invalidated += 1
        self._cache = {key: cached for key, cached in self._cache.items() if cached[0].user != user}
        invalidation = self._invalidations.pop(user, None)
        if invalidation is not None:
            invalidation.set_result(None)

    def invalidation(self, user: str) -> asyncio.Future[None]:
        """Return a future that is done when this user must authenticate again, for long-running responses."""
        if user not in self._invalidations:
            self._invalidations[user] = asyncio.get_running_loop().create_future()
        return self._invalidations[user]

    def record(self, client: Client, action: str, thing: str, result: str, address: str) -> None:
        """Record an operation in the Master's audit log, in the background."""
        task = asyncio.create_task(self._record(RecordAction(client.identity, action, thing, result, address)))
        self._records.add(task)
        task.add_done_callback(self._records.discard)

    async def _record(self, call: RecordAction) -> None:
        try:
            await self._master().call(call)
        except RceError as error:
            log.warn("missing in the audit log: {action}: {error}", action=call, error=str(error))

    async def create_grant(self, user: str, secret: str) -> str:
        """Get the right to act for a user; return the name of the grant."""
        return str((await self._master().call(CreateGrant(user, secret))).grant)

    async def issue_key(self, grant: str, seconds: float) -> TemporaryKey:
        """Get a key, valid for this time, to connect as a robot of the grant's user."""
        key: TemporaryKey = await self._master().call(IssueKey(grant, seconds))
        return key

    async def revoke_grant(self, grant: str) -> None:
        """Give a grant back."""
        await self._master().call(RevokeGrant(grant), wait=60.0)


def credentials(headers: Mapping[str, str], query: Mapping[str, str]) -> tuple[str, str]:
    """Return the user, empty if an API key is given without it, and the API key or the SHA-256 of the password.

    Accepted are `Authorization: Bearer KEY`, `Authorization: Basic` with a key or the password, and, as at the robots'
    entry, `userID` with `key` or `password` (its SHA-256) in the query.

    Raises:
        Unauthorized: There are no credentials, or they are malformed.
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
