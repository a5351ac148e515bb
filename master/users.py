"""Users, their passwords and API keys; the credentials of the platform's own processes.

A password is stored as argon2 of its SHA-256 hex, since that is what robots send; an API key and a join token as
SHA-256: they are random, so a slow hash would add nothing. An argon2 check is slow on purpose, and few run at once.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from typing import Any

import argon2
import sqlalchemy as sa
from msgspec import Struct

from master import store as db
from master.grants import LENT_PREFIX, Grants
from master.grants import digest as digest
from master.records import Role
from master.rights import Principal, check
from rce.errors import AlreadyExists, InvalidRequest, NotFound, Unauthorized
from rce.names import check_tag
from rce.roles import UserRole

KEY_PREFIX = "rce_"
CHECKS_AT_ONCE = 2
MACHINE = "machine"  # the role of a token that is a machine's invitation


class ApiKey(Struct, frozen=True):
    """An API key as it may be shown: without the key itself. Times are seconds since 1970."""

    id: str
    user: str
    role: UserRole
    label: str
    created: float
    expires: float | None


class Users:
    """People and programs that may use the platform."""

    def __init__(self, store: db.Store) -> None:
        self.grants = Grants(store)
        self._store = store
        self._hasher = argon2.PasswordHasher(time_cost=2, memory_cost=19_456, parallelism=1)  # OWASP's minimum
        self._checks = asyncio.Semaphore(CHECKS_AT_ONCE)

    async def add(self, name: str, password: str, role: UserRole = "user") -> None:
        check_tag(name, "userID")
        hashed = await asyncio.to_thread(self._hasher.hash, digest(password))
        row = {"name": name, "password": hashed, "role": role, "created": time.time()}
        try:
            await self._store.run(lambda connection: connection.execute(db.users.insert(), row))
        except sa.exc.IntegrityError:
            raise AlreadyExists(f"user {name} exists already", field="userID") from None

    async def names(self) -> list[str]:
        found = await self._store.run(lambda connection: list(connection.scalars(sa.select(db.users.c.name))))
        return sorted(found)

    async def remove(self, name: str) -> None:
        def drop(connection: sa.Connection) -> int:
            connection.execute(db.limits.delete().where(db.limits.c.user == name))
            return connection.execute(db.users.delete().where(db.users.c.name == name)).rowcount

        if not await self._store.run(drop):
            raise NotFound(f"there is no user {name}", field="userID")

    async def check(self, name: str, secret: str) -> Principal:
        """`secret` is an API key or the SHA-256 hex of the password. Unauthorized says no more than that.

        With an API key the name may be empty: the key knows its user.
        """
        if secret.startswith(LENT_PREFIX):
            return Principal(await self.grants.check(name, secret), "robot", lent=True)
        if secret.startswith(KEY_PREFIX):
            return await self._check_key(name, secret)
        query = sa.select(db.users.c.password, db.users.c.role).where(db.users.c.name == name)
        row = await self._store.run(lambda connection: connection.execute(query).first())
        async with self._checks:
            # An unknown user costs the same time as a wrong password.
            good = await asyncio.to_thread(self._verify, row.password if row else self._decoy, secret.lower())
        if row is None or not good:
            raise Unauthorized("user or password is wrong")
        return Principal(name, row.role)

    @property
    def _decoy(self) -> str:
        return "$argon2id$v=19$m=19456,t=2,p=1$MDEyMzQ1Njc4OWFiY2RlZg$1tTS0Sl0WxSQqvnBzLCbWa2CKYGFyN8s0mN0Pa6yjgk"

    def _verify(self, hashed: str, secret: str) -> bool:
        try:
            return self._hasher.verify(hashed, secret)
        except argon2.exceptions.VerificationError:
            return False

    async def _check_key(self, name: str, secret: str) -> Principal:
        query = sa.select(db.api_keys).where(db.api_keys.c.digest == digest(secret))
        row = await self._store.run(lambda connection: connection.execute(query).first())
        if row is None or name not in ("", row.user) or (row.expires is not None and row.expires < time.time()):
            raise Unauthorized("the API key is wrong, expired or revoked, or another user's")
        return Principal(row.user, row.role, row.id)

    async def add_key(
        self, user: str, role: UserRole = "robot", label: str = "", expires: float | None = None
    ) -> tuple[str, ApiKey]:
        """A new key: the secret, shown this once, and what is kept."""
        secret = KEY_PREFIX + secrets.token_hex(20)
        key = ApiKey(secrets.token_hex(8), user, role, label, time.time(), expires)
        row = {field: getattr(key, field) for field in key.__struct_fields__} | {"digest": digest(secret)}
        try:
            await self._store.run(lambda connection: connection.execute(db.api_keys.insert(), row))
        except sa.exc.IntegrityError:
            raise NotFound(f"there is no user {user}", field="userID") from None
        return secret, key

    async def keys(self, user: str) -> list[ApiKey]:
        query = sa.select(db.api_keys).where(db.api_keys.c.user == user).order_by(db.api_keys.c.created)
        rows: list[Any] = await self._store.run(lambda connection: list(connection.execute(query)))
        return [ApiKey(row.id, row.user, row.role, row.label, row.created, row.expires) for row in rows]

    async def revoke_key(self, user: str, key_id: str) -> None:
        where = sa.and_(db.api_keys.c.user == user, db.api_keys.c.id == key_id)
        gone = await self._store.run(lambda connection: connection.execute(db.api_keys.delete().where(where)).rowcount)
        if not gone:
            raise NotFound(f"user {user} has no API key {key_id}")


def must_drive(principal: Principal, robot: str = "") -> None:
    """Refuse those who may not connect as this robot."""
    if principal.role == "admin":
        raise InvalidRequest("an administrator cannot connect as a robot: use a user of another role", field="userID")
    check(principal, "robot.connect", principal.user, robot=robot)


class Processes:
    """Join tokens, each good for one process once, and the credentials that processes got for them."""

    def __init__(self, store: db.Store) -> None:
        self._store = store

    async def allow(self, process: str, role: Role, token: str) -> None:
        """Let a process join with this token; a token that was used stays used."""

        def put(connection: sa.Connection) -> None:
            row = {"digest": digest(token), "process": process, "role": role, "used": False}
            if connection.execute(sa.select(db.tokens).where(db.tokens.c.digest == row["digest"])).first() is None:
                connection.execute(db.tokens.insert(), row)

        await self._store.run(put)

    async def invite(self, machine: str, invitation: str) -> None:
        """Let a machine join once with an invitation of this digest; an earlier one of the same machine is void."""

        def put(connection: sa.Connection) -> None:
            unused = sa.and_(db.tokens.c.process == machine, db.tokens.c.role == MACHINE, db.tokens.c.used.is_(False))
            connection.execute(db.tokens.delete().where(unused))
            row = {"digest": invitation, "process": machine, "role": MACHINE, "used": False}
            connection.execute(db.tokens.insert(), row)

        await self._store.run(put)

    async def redeem(self, machine: str, invitation: str) -> bool:
        """Whether the invitation of this digest was good; it is used up."""
        where = sa.and_(
            db.tokens.c.digest == invitation,
            db.tokens.c.process == machine,
            db.tokens.c.role == MACHINE,
            db.tokens.c.used.is_(False),
        )
        statement = db.tokens.update().where(where).values(used=True)
        return bool(await self._store.run(lambda connection: connection.execute(statement).rowcount))

    async def admit(self, process: str, role: str, secret: str) -> str:
        """The credential of a process that presents its token or its earlier credential. Unauthorized."""
        fresh = secrets.token_hex(32)
        if role == MACHINE:
            raise Unauthorized("an invitation is for a machine, not for a process")

        def check(connection: sa.Connection) -> str | None:
            known = connection.execute(sa.select(db.credentials).where(db.credentials.c.process == process)).first()
            if known is not None and known.role == role and secrets.compare_digest(known.digest, digest(secret)):
                return secret
            token = sa.and_(
                db.tokens.c.digest == digest(secret),
                db.tokens.c.process == process,
                db.tokens.c.role == role,
                db.tokens.c.used.is_(False),
            )
            if not connection.execute(db.tokens.update().where(token).values(used=True)).rowcount:
                return None
            connection.execute(db.credentials.delete().where(db.credentials.c.process == process))
            row = {"process": process, "role": role, "digest": digest(fresh)}
            connection.execute(db.credentials.insert(), row)
            return fresh

        credential = await self._store.run(check)
        if credential is None:
            raise Unauthorized(f"{role} {process} may not join: its token is unknown or was used; get a new one")
        return credential

    async def names(self) -> list[str]:
        """The processes that have joined at least once; environments are not among them."""
        query = sa.select(db.credentials.c.process).where(db.credentials.c.role != "environment")
        return await self._store.run(lambda connection: sorted(connection.scalars(query)))

    async def forget(self, process: str) -> None:
        """The process shall not join again."""

        def drop(connection: sa.Connection) -> None:
            connection.execute(db.credentials.delete().where(db.credentials.c.process == process))
            connection.execute(db.tokens.delete().where(db.tokens.c.process == process))

        await self._store.run(drop)
