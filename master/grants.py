"""Rights that users give to services, such as the map service: to act as a robot of theirs for one job.

A grant is a name and opens nothing by itself: only the service that it was given to takes keys for it, over its control
connection. Such a key is short-lived, one at a time, and good for connecting as a robot. A grant ends with its job, and
with the user or the API key by which it was given.
"""

from __future__ import annotations

import hashlib
import secrets
import time

import sqlalchemy as sa

from master import store as db
from rce.calls.services import LentKey
from rce.errors import Unauthorized
from rce.roles import Principal

KEY_PREFIX = "rce_"
LENT_PREFIX = "rce_lent_"
VOID = "the right to act for this user has ended: the user or the API key is gone, or the key has expired"


def digest(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


class Grants:
    """What the services may do for whom."""

    def __init__(self, store: db.Store) -> None:
        self._store = store

    async def give(self, service: str, user: str, key: str) -> str:
        """The name of a new grant; `key` is the id of the API key that the user showed, empty for a password."""
        name = secrets.token_hex(16)
        row = {"id": name, "service": service, "user": user, "key": key or None, "created": time.time()}
        try:
            await self._store.run(lambda connection: connection.execute(db.grants.insert(), row))
        except sa.exc.IntegrityError:  # gone since they were checked
            raise Unauthorized(VOID) from None
        return name

    async def borrow(self, service: str, grant: str, seconds: float) -> LentKey:
        """A new key for the grant, in place of the one before. Unauthorized."""
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
        return LentKey(user, secret)

    async def end(self, service: str, grant: str) -> None:
        """Ending one that has ended already does nothing."""
        where = sa.and_(db.grants.c.id == grant, db.grants.c.service == service)
        await self._store.run(lambda connection: connection.execute(db.grants.delete().where(where)))

    async def check(self, user: str, secret: str) -> Principal:
        """The user whose robot the bearer of a lent key may be. Unauthorized."""
        query = _valid().where(db.grants.c.lent == digest(secret), db.grants.c.expires > time.time())
        row = await self._store.run(lambda connection: connection.execute(query).first())
        if row is None or user not in ("", row.user):
            raise Unauthorized("the key is wrong or expired, or its job is over")
        return Principal(row.user, "robot", row.key or "", lent=True)


def _valid() -> sa.Select[tuple[str, str]]:
    """Grants whose API key, if they were given with one, has not expired."""
    keys = db.api_keys
    good = sa.or_(db.grants.c.key.is_(None), keys.c.expires.is_(None), keys.c.expires > time.time())
    return sa.select(db.grants.c.user, db.grants.c.key).outerjoin(keys, keys.c.id == db.grants.c.key).where(good)
