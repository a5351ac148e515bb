"""The platform's own processes: join tokens, each good for one process once, and the credentials got for them.

A token is random, so its SHA-256 is stored: a slow hash would add nothing.
"""

from __future__ import annotations

import secrets

import sqlalchemy as sa

from master import store as db
from master.grants import digest
from master.records import Role
from rce.errors import Unauthorized

MACHINE = "machine"  # the role of a token that is a machine's invitation


class Processes:
    """Who may join."""

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
