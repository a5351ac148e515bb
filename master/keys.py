"""API keys: made, shown once, rotated, revoked. Stored as SHA-256: they are random, a slow hash would add nothing."""

from __future__ import annotations

import secrets
import time
from typing import Any

import msgspec
import sqlalchemy as sa

from master import store as db
from master.grants import KEY_PREFIX, digest
from rce.errors import Forbidden, InvalidRequest, LimitExceeded, NotFound, Unauthorized
from rce.names import check_tag
from rce.roles import FREE, WITHIN, Principal, Scopes, UserRole
from rce.views import KeyView

MOST = 1000  # keys of one user


class Keys:
    """All API keys of the platform."""

    def __init__(self, store: db.Store) -> None:
        self._store = store
        self._used: dict[str, float] = {}  # since the last `note_use`, by id

    async def add(
        self, user: str, role: UserRole = "robot", label: str = "", expires: float | None = None, scopes: Scopes = FREE
    ) -> tuple[str, KeyView]:
        """A new key: the secret, shown this once, and what is kept. NotFound, Forbidden, InvalidRequest."""
        _check_scopes(role, scopes)
        secret = _fresh()
        key = KeyView(secrets.token_hex(8), user, role, label, time.time(), expires, None, scopes)
        row = msgspec.structs.asdict(key) | {"digest": digest(secret), "scopes": _text(scopes)}

        def put(connection: sa.Connection) -> None:
            own = connection.scalar(sa.select(db.users.c.role).where(db.users.c.name == user))
            if own is None:
                raise NotFound(f"there is no user {user[:80]}", field="user")
            if role not in WITHIN[own]:
                raise Forbidden(f"a key of {user} may not be of the role {role}: the user's is {own}", field="role")
            if len(list(connection.execute(_of(user)))) >= MOST:
                raise LimitExceeded(f"{user} has {MOST} API keys: revoke some", field="user", limit=MOST)
            connection.execute(db.api_keys.insert(), row)

        await self._store.run(put)
        return secret, key

    async def of(self, user: str) -> list[KeyView]:
        """The oldest first."""
        rows = await self._store.run(lambda connection: list(connection.execute(_of(user))))
        return [self._shown(row) for row in rows]

    async def all(self) -> list[KeyView]:
        query = sa.select(db.api_keys).order_by(db.api_keys.c.user, db.api_keys.c.created)
        rows = await self._store.run(lambda connection: list(connection.execute(query)))
        return [self._shown(row) for row in rows]

    async def get(self, user: str, key_id: str) -> KeyView:
        """NotFound."""
        query = sa.select(db.api_keys).where(_is(user, key_id))
        row = await self._store.run(lambda connection: connection.execute(query).first())
        if row is None:
            raise NotFound(f"there is no API key {key_id[:80]!r}", field="key")
        return self._shown(row)

    async def rotate(self, user: str, key_id: str) -> tuple[str, KeyView]:
        """A new secret for the same key; the old one is void at once. NotFound."""
        secret = _fresh()
        statement = db.api_keys.update().where(_is(user, key_id)).values(digest=digest(secret))
        changed = await self._store.run(lambda connection: connection.execute(statement).rowcount)
        if not changed:
            raise NotFound(f"there is no API key {key_id[:80]!r}", field="key")
        return secret, await self.get(user, key_id)

    async def revoke(self, user: str, key_id: str) -> None:
        """NotFound."""
        statement = db.api_keys.delete().where(_is(user, key_id))
        if not await self._store.run(lambda connection: connection.execute(statement).rowcount):
            raise NotFound(f"there is no API key {key_id[:80]!r}", field="key")
        self._used.pop(key_id, None)

    async def check(self, name: str, secret: str) -> Principal:
        """Whose key this is; the name may be empty. Unauthorized."""
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
        if row.role not in WITHIN[row.most]:
            raise Unauthorized(f"the API key is of the role {row.role}, and its user's is {row.most} now")
        self._used[row.id] = now
        return Principal(row.user, row.role, row.id, scopes=_scopes(row))

    async def note_use(self) -> None:
        """Write when keys were last used; done now and then, so that a login waits for no disk."""
        used, self._used = self._used, {}
        if used:
            statement = db.api_keys.update().where(db.api_keys.c.id == sa.bindparam("key"))
            rows = [{"key": key, "at": when} for key, when in used.items()]
            await self._store.run(
                lambda connection: connection.execute(statement.values(used=sa.bindparam("at")), rows)
            )

    def _shown(self, row: Any) -> KeyView:
        used = self._used.get(row.id, row.used)
        return KeyView(row.id, row.user, row.role, row.label, row.created, row.expires, used, _scopes(row))


def _fresh() -> str:
    return KEY_PREFIX + secrets.token_hex(20)


def _of(user: str) -> sa.Select[Any]:
    return sa.select(db.api_keys).where(db.api_keys.c.user == user).order_by(db.api_keys.c.created)


def _is(user: str, key_id: str) -> sa.ColumnElement[bool]:
    return sa.and_(db.api_keys.c.user == user, db.api_keys.c.id == key_id)


def _text(scopes: Scopes) -> str | None:
    return None if scopes == FREE else msgspec.json.encode(scopes).decode()


def _scopes(row: Any) -> Scopes:
    return msgspec.json.decode(row.scopes, type=Scopes) if row.scopes else FREE


def _check_scopes(role: UserRole, scopes: Scopes) -> None:
    if scopes.tied and role != "robot":
        raise InvalidRequest(f"a key of the role {role} cannot be tied: only those of the role robot", field="scopes")
    if scopes.metrics and role not in ("operator", "admin"):
        raise InvalidRequest("metrics are of the whole platform: such a key is an operator's", field="scopes.metrics")
    if scopes.robot:
        check_tag(scopes.robot, "scopes.robot")
    for environment in scopes.environments:
        check_tag(environment, "scopes.environments")
