"""API keys: created, shown once, rotated, revoked.

The database has their SHA-256. They are random, so that a slow hash would add nothing.
"""

from __future__ import annotations

import secrets
import time
from typing import Any

import msgspec
import sqlalchemy as sa

from master.access.grants import KEY_PREFIX, digest
from master.storage import tables as db
from master.storage.store import Store
from rce.api.roles import ASSIGNABLE_ROLES, UNRESTRICTED, Principal, Scopes, UserRole
from rce.api.views import KeyView
from rce.errors import Forbidden, InvalidRequest, LimitExceeded, NotFound, Unauthorized
from rce.protocol.names import check_tag

MAX_KEYS = 1000  # of one user


class Keys:
    """All API keys of the platform."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._used: dict[str, float] = {}  # times of use since the last `note_use`, by id

    async def add(
        self,
        user: str,
        role: UserRole = "robot",
        label: str = "",
        expires: float | None = None,
        scopes: Scopes = UNRESTRICTED,
    ) -> tuple[str, KeyView]:
        """Create a key and return its secret, which is not stored, and its view.

        Raises:
            NotFound: There is no such user.
            Forbidden: The user's role is below the key's.
            InvalidRequest: The scopes do not fit the role.
            LimitExceeded: The user has too many keys.
        """
        _check_scopes(role, scopes)
        secret = _new_secret()
        key = KeyView(secrets.token_hex(8), user, role, label, time.time(), expires, None, scopes)
        row = msgspec.structs.asdict(key) | {"digest": digest(secret), "scopes": _text(scopes)}

        def put(connection: sa.Connection) -> None:
            own = connection.scalar(sa.select(db.users.c.role).where(db.users.c.name == user))
            if own is None:
                raise NotFound(f"there is no user {user[:80]}", field="user")
            if role not in ASSIGNABLE_ROLES[own]:
                raise Forbidden(f"a key of {user} may not be of the role {role}: the user's is {own}", field="role")
            if len(list(connection.execute(_of(user)))) >= MAX_KEYS:
                raise LimitExceeded(f"{user} has {MAX_KEYS} API keys: revoke some", field="user", limit=MAX_KEYS)
            connection.execute(db.api_keys.insert(), row)

        await self._store.run(put)
        return secret, key

    async def of(self, user: str) -> list[KeyView]:
        """Return the keys of a user, oldest first."""
        rows = await self._store.run(lambda connection: list(connection.execute(_of(user))))
        return [self._view(row) for row in rows]

    async def all(self) -> list[KeyView]:
        """Return the keys of all users."""
        query = sa.select(db.api_keys).order_by(db.api_keys.c.user, db.api_keys.c.created)
        rows = await self._store.run(lambda connection: list(connection.execute(query)))
        return [self._view(row) for row in rows]

    async def get(self, user: str, key_id: str) -> KeyView:
        """Return a key.

        Raises:
            NotFound: The user has no such key.
        """
        query = sa.select(db.api_keys).where(_is(user, key_id))
        row = await self._store.run(lambda connection: connection.execute(query).first())
        if row is None:
            raise NotFound(f"there is no API key {key_id[:80]!r}", field="key")
        return self._view(row)

    async def rotate(self, user: str, key_id: str) -> tuple[str, KeyView]:
        """Replace the secret of a key; the old one is invalid at once.

        Raises:
            NotFound: The user has no such key.
        """
        secret = _new_secret()
        statement = db.api_keys.update().where(_is(user, key_id)).values(digest=digest(secret))
        changed = await self._store.run(lambda connection: connection.execute(statement).rowcount)
        if not changed:
            raise NotFound(f"there is no API key {key_id[:80]!r}", field="key")
        return secret, await self.get(user, key_id)

    async def revoke(self, user: str, key_id: str) -> None:
        """Revoke a key.

        Raises:
            NotFound: The user has no such key.
        """
        statement = db.api_keys.delete().where(_is(user, key_id))
        if not await self._store.run(lambda connection: connection.execute(statement).rowcount):
            raise NotFound(f"there is no API key {key_id[:80]!r}", field="key")
        self._used.pop(key_id, None)

    async def check(self, name: str, secret: str) -> Principal:
        """Authenticate by an API key; the name of the user may be empty.

        Raises:
            Unauthorized: The key is unknown, expired, or another user's.
        """
        keys = db.api_keys
        query = (
            sa.select(keys, db.users.c.role.label("most"))
            .join(db.users, db.users.c.name == keys.c.user)
            .where(keys.c.digest == digest(secret))
        )
        row = await self._store.run(lambda connection: connection.execute(query).first())
        now = time.time()
        if row is None or name not in ("", row.user) or (row.expires is not None and row.expires < now):
            raise Unauthorized("the API key is wrong, expired or revoked, or another user's")
        if row.role not in ASSIGNABLE_ROLES[row.most]:
            raise Unauthorized(f"the API key is of the role {row.role}, and its user's is {row.most} now")
        self._used[row.id] = now
        return Principal(row.user, row.role, row.id, scopes=_scopes(row))

    async def note_use(self) -> None:
        """Store when keys were last used. It is called periodically, so that no login waits for the disk."""
        used, self._used = self._used, {}
        if not used:
            return
        statement = db.api_keys.update().where(db.api_keys.c.id == sa.bindparam("key")).values(used=sa.bindparam("at"))
        rows = [{"key": key, "at": when} for key, when in used.items()]
        try:
            await self._store.run(lambda connection: connection.execute(statement, rows))
        except sa.exc.SQLAlchemyError:
            self._used = used | self._used  # stored by the next call
            raise

    def _view(self, row: Any) -> KeyView:
        used = self._used.get(row.id, row.used)
        return KeyView(row.id, row.user, row.role, row.label, row.created, row.expires, used, _scopes(row))


def _new_secret() -> str:
    return KEY_PREFIX + secrets.token_hex(20)


def _of(user: str) -> sa.Select[Any]:
    return sa.select(db.api_keys).where(db.api_keys.c.user == user).order_by(db.api_keys.c.created)


def _is(user: str, key_id: str) -> sa.ColumnElement[bool]:
    return sa.and_(db.api_keys.c.user == user, db.api_keys.c.id == key_id)


def _text(scopes: Scopes) -> str | None:
    return None if scopes == UNRESTRICTED else msgspec.json.encode(scopes).decode()


def _scopes(row: Any) -> Scopes:
    return msgspec.json.decode(row.scopes, type=Scopes) if row.scopes else UNRESTRICTED


def _check_scopes(role: UserRole, scopes: Scopes) -> None:
    if scopes.tied and role != "robot":
        raise InvalidRequest(f"a key of the role {role} cannot be tied: only those of the role robot", field="scopes")
    if scopes.metrics and role not in ("operator", "admin"):
        raise InvalidRequest("metrics are of the whole platform: such a key is an operator's", field="scopes.metrics")
    if scopes.robot:
        check_tag(scopes.robot, "scopes.robot")
    for environment in scopes.environments:
        check_tag(environment, "scopes.environments")
