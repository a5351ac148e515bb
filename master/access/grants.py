"""Grants: rights that users give to services, such as the map service, to act as a robot of theirs for one job.

A grant opens nothing by itself: only the service to which it was given gets temporary keys for it, over its control
connection. Such a key is short-lived, one at a time, and valid for connecting as a robot. A grant ends with its job,
with its user, or with the API key by which it was given.
"""

from __future__ import annotations

import hashlib
import secrets
import time

import sqlalchemy as sa

from master.storage import tables as db
from master.storage.store import Store
from rce.api.roles import Principal
from rce.control.calls.services import TemporaryKey
from rce.errors import Unauthorized

KEY_PREFIX = "rce_"
LENT_PREFIX = "rce_lent_"
VOID = "the right to act for this user has ended: the user or the API key is gone, or the key has expired"


def digest(secret: str) -> str:
    """Return the SHA-256 of a random secret in hex."""
    return hashlib.sha256(secret.encode()).hexdigest()


class Grants:
    """Grants in the database."""

    def __init__(self, store: Store) -> None:
        self._store = store

    async def give(self, service: str, user: str, key: str) -> str:
        """Create a grant and return its name; `key` is the id of the user's API key, empty for a password.

        Raises:
            Unauthorized: The user or the key was removed meanwhile.
        """
        name = secrets.token_hex(16)
        row = {"id": name, "service": service, "user": user, "key": key or None, "created": time.time()}
        try:
            await self._store.run(lambda connection: connection.execute(db.grants.insert(), row))
        except sa.exc.IntegrityError:  # user or key were removed since they were checked
            raise Unauthorized(VOID) from None
        return name

    async def issue_key(self, service: str, grant: str, seconds: float) -> TemporaryKey:
        """Issue a temporary key for a grant; the one before is invalid.

        Raises:
            Unauthorized: The grant has ended.
        """
        secret = LENT_PREFIX + secrets.token_hex(20)

        def lend(connection: sa.Connection) -> str | None:
            where = sa.and_(db.grants.c.id == grant, db.grants.c.service == service)
            row = connection.execute(_valid().where(where)).first()
            if row is None:
                return None
            values = {"lent": digest(secret), "expires": time.time() + seconds}
            connection.execute(db.grants.update().where(where).values(values))
            return str(row.user)

        user = await self._store.run(lend)
        if user is None:
            raise Unauthorized(VOID)
        return TemporaryKey(user, secret)

    async def end(self, service: str, grant: str) -> None:
        """End a grant, unless it has ended already."""
        where = sa.and_(db.grants.c.id == grant, db.grants.c.service == service)
        await self._store.run(lambda connection: connection.execute(db.grants.delete().where(where)))

    async def check(self, user: str, secret: str) -> Principal:
        """Authenticate by a temporary key.

        Raises:
            Unauthorized: The key is wrong, expired, or of another user.
        """
        query = _valid().where(db.grants.c.lent == digest(secret), db.grants.c.expires > time.time())
        row = await self._store.read(lambda connection: connection.execute(query).first())
        if row is None or user not in ("", row.user):
            raise Unauthorized("the key is wrong or expired, or its job is over")
        return Principal(row.user, "robot", row.key or "", lent=True)


def _valid() -> sa.Select[tuple[str, str]]:
    """Select grants whose API key, if any, has not expired."""
    keys = db.api_keys
    good = sa.or_(db.grants.c.key.is_(None), keys.c.expires.is_(None), keys.c.expires > time.time())
    return sa.select(db.grants.c.user, db.grants.c.key).outerjoin(keys, keys.c.id == db.grants.c.key).where(good)
