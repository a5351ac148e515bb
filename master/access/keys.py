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
from master.storage.store import FAILURES, Store
from rce.api.roles import ASSIGNABLE_ROLES, UNRESTRICTED, Principal, Scopes, UserRole
from rce.api.views import KeyView
from rce.errors import Forbidden, InvalidRequest, LimitExceeded, NotFound, Unauthorized
from rce.protocol.names import check_tag

MAX_KEYS = 1000  # of one user
_BY_DIGEST = (  # made once, because each login needs it
    sa.select(db.api_keys, db.users.c.role.label("most"))
    .join(db.users, db.users.c.name == db.api_keys.c.user)
    .where(db.api_keys.c.digest == sa.bindparam("of"))
)


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
        parent: str = "",
    ) -> tuple[str, KeyView]:
        """Create a key and return its secret, which is not stored, and its view.

        `parent` is the id of the key with which it is made: the new one ends with it, and expires no later.

        Raises:
            NotFound: There is no such user.
            Forbidden: The user's role is below the key's, or it would outlive its parent.
            InvalidRequest: The scopes do not fit the role.
            LimitExceeded: The user has too many keys.
            Unauthorized: The parent was revoked.
        """
        _check_scopes(role, scopes)
        secret = _new_secret()
        key = KeyView(secrets.token_hex(8), user, role, label, time.time(), expires, None, scopes, parent)
        row = msgspec.structs.asdict(key) | {"digest": digest(secret), "scopes": _text(scopes)}

        def put(connection: sa.Connection) -> KeyView:
            until = _expiry_within(connection, parent, expires)
            own = connection.scalar(sa.select(db.users.c.role).where(db.users.c.name == user))
            if own is None:
                raise NotFound(f"there is no user {user[:80]}", field="user")
            if role not in ASSIGNABLE_ROLES[own]:
                raise Forbidden(f"a key of {user} may not be of the role {role}: the user's is {own}", field="role")
            if len(list(connection.execute(_of(user)))) >= MAX_KEYS:
                raise LimitExceeded(f"{user} has {MAX_KEYS} API keys: revoke some", field="user", limit=MAX_KEYS)
            connection.execute(db.api_keys.insert(), row | {"expires": until, "parent": parent or None})
            return msgspec.structs.replace(key, expires=until)

        return secret, await self._store.run(put)

    async def of(self, user: str) -> list[KeyView]:
        """Return the keys of a user, oldest first."""
        rows = await self._store.read(lambda connection: list(connection.execute(_of(user))))
        return [self._view(row) for row in rows]

    async def all(self) -> list[KeyView]:
        """Return the keys of all users."""
        query = sa.select(db.api_keys).order_by(db.api_keys.c.user, db.api_keys.c.created)
        rows = await self._store.read(lambda connection: list(connection.execute(query)))
        return [self._view(row) for row in rows]

    async def get(self, user: str, key_id: str) -> KeyView:
        """Return a key.

        Raises:
            NotFound: The user has no such key.
        """
        query = sa.select(db.api_keys).where(_is(user, key_id))
        row = await self._store.read(lambda connection: connection.execute(query).first())
        if row is None:
            raise _unknown(key_id)
        return self._view(row)

    async def rotate(self, user: str, key_id: str, by: str = "") -> tuple[str, KeyView]:
        """Replace the secret of a key; the old one is invalid at once, and keys that were made with it stay.

        `by` is the id of the key with which this is done, empty for a password. Since the new secret must not outlive
        it, a key rotates only itself and keys that were made with it.

        Raises:
            NotFound: The user has no such key.
            Forbidden: It was not made with the key `by`.
        """
        secret = _new_secret()
        statement = db.api_keys.update().where(_is(user, key_id)).values(digest=digest(secret))

        def put(connection: sa.Connection) -> None:
            if connection.execute(sa.select(db.api_keys.c.id).where(_is(user, key_id))).first() is None:
                raise _unknown(key_id)
            if by and key_id not in _made_with(connection, by):
                raise Forbidden(
                    "a key rotates itself and the keys that were made with it; rotate this one with your password",
                    field="key",
                )
            connection.execute(statement)

        await self._store.run(put)
        return secret, await self.get(user, key_id)

    async def revoke(self, user: str, key_id: str) -> set[str]:
        """Revoke a key and all keys that were made with it, and return their users.

        Raises:
            NotFound: The user has no such key.
        """

        def drop(connection: sa.Connection) -> dict[str, str]:
            gone = _made_with(connection, key_id)
            if not connection.execute(db.api_keys.delete().where(_is(user, key_id))).rowcount:
                raise _unknown(key_id)
            return gone

        gone = await self._store.run(drop)
        for each in gone:
            self._used.pop(each, None)
        return set(gone.values())

    async def check(self, name: str, secret: str) -> Principal:
        """Authenticate by an API key; the name of the user may be empty.

        Raises:
            Unauthorized: The key is unknown, expired, or another user's.
        """
        row = await self._store.read(lambda connection: connection.execute(_BY_DIGEST, {"of": digest(secret)}).first())
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
        except FAILURES:
            self._used = used | self._used  # stored by the next call
            raise

    def _view(self, row: Any) -> KeyView:
        used = self._used.get(row.id, row.used)
        return KeyView(
            *(row.id, row.user, row.role, row.label, row.created, row.expires, used, _scopes(row), row.parent or "")
        )


def _new_secret() -> str:
    return KEY_PREFIX + secrets.token_hex(20)


def _of(user: str) -> sa.Select[Any]:
    return sa.select(db.api_keys).where(db.api_keys.c.user == user).order_by(db.api_keys.c.created)


def _is(user: str, key_id: str) -> sa.ColumnElement[bool]:
    return sa.and_(db.api_keys.c.user == user, db.api_keys.c.id == key_id)


def _unknown(key_id: str) -> NotFound:
    return NotFound(f"there is no API key {key_id[:80]!r}", field="key")


def _made_with(connection: sa.Connection, key_id: str) -> dict[str, str]:
    """Return a key and all that were made with it, directly or not, by their ids with their users."""
    keys = db.api_keys
    found = sa.select(keys.c.id, keys.c.user).where(keys.c.id == key_id).cte("made", recursive=True)
    found = found.union_all(sa.select(keys.c.id, keys.c.user).join(found, keys.c.parent == found.c.id))
    return {row.id: row.user for row in connection.execute(sa.select(found))}


def _expiry_within(connection: sa.Connection, parent: str, expires: float | None) -> float | None:
    """Return when a key expires that is made with the key `parent`, empty for none."""
    if not parent:
        return expires
    row = connection.execute(sa.select(db.api_keys.c.expires).where(db.api_keys.c.id == parent)).first()
    if row is None:
        raise Unauthorized("the API key was revoked")
    if row.expires is not None and expires is not None and expires > row.expires:
        until = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(row.expires))
        raise Forbidden(
            f"expires: a key that is made with a key ends with it, here at {until}; ask for an earlier time, or make "
            "the key with your password",
            field="expires",
        )
    return row.expires if expires is None else expires


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
