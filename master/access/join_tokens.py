"""Join tokens: each is valid once, for one process, and is exchanged for the credential of that process.

Tokens are random, so that the database has their SHA-256: a slow hash would add nothing.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Collection
from typing import get_args

import sqlalchemy as sa

from master.access.grants import digest
from master.graph.records import Role
from master.storage import tables as db
from master.storage.store import Store
from rce.api.joining import Role as MachineRole
from rce.api.joining import process_name, sibling_name
from rce.control.calls.joining import JoinToken
from rce.errors import InvalidRequest, NotFound, Unauthorized
from rce.net.certificates import MACHINE_DAYS

DAY = 86_400.0  # seconds
LEAST_LENGTH = 32  # characters of a credential that a process made
MACHINE = "machine"  # role of the invitation of a machine
SIBLINGS = range(2, 65)  # numbers of the further processes of a Robot endpoint
_CREDENTIAL = sa.select(db.credentials.c.role, db.credentials.c.digest).where(
    db.credentials.c.process == sa.bindparam("process")
)


class JoinTokens:
    """Join tokens and credentials of processes, in the database."""

    def __init__(self, store: Store) -> None:
        self._store = store

    async def allow(self, process: str, role: Role, token: str) -> None:
        """Allow a process to join with this token, unless the token was used already."""

        def put(connection: sa.Connection) -> None:
            row = {"digest": digest(token), "process": process, "role": role, "used": False}
            if connection.execute(sa.select(db.tokens).where(db.tokens.c.digest == row["digest"])).first() is None:
                connection.execute(db.tokens.insert(), row)

        await self._store.run(put)

    async def renew(self, process: str, role: Role, token: str) -> None:
        """Allow a process to join with this token, and with none of its earlier tokens and credentials."""

        def put(connection: sa.Connection) -> None:
            _drop(connection, [process])
            row = {"digest": digest(token), "process": process, "role": role, "used": False}
            connection.execute(db.tokens.insert(), row)

        await self._store.run(put, repeatable=True)

    async def invite(self, machine: str, invitation: str, key: str = "") -> None:
        """Store the invitation of a machine by its digest; an earlier unused one is revoked.

        It ends with the API key of this id, with which it was made.

        Raises:
            Unauthorized: The key was revoked.
        """

        def put(connection: sa.Connection) -> None:
            unused = sa.and_(db.tokens.c.process == machine, db.tokens.c.role == MACHINE, db.tokens.c.used.is_(False))
            connection.execute(db.tokens.delete().where(unused))
            row = {"digest": invitation, "process": machine, "role": MACHINE, "used": False, "key": key or None}
            connection.execute(db.tokens.insert(), row)

        try:
            await self._store.run(put)
        except sa.exc.IntegrityError:
            raise Unauthorized("the API key was revoked") from None

    async def invite_sibling(self, endpoint: str, number: int) -> JoinToken:
        """Return a join token for a further process of a Robot endpoint; an earlier unused one is revoked.

        Raises:
            InvalidRequest: An endpoint has no process of this number, or `endpoint` is itself a further process.
        """
        if "." in endpoint or number not in SIBLINGS:
            raise InvalidRequest(
                f"{endpoint} has no further process {number}: a first process has {SIBLINGS[0]} to {SIBLINGS[-1]}"
            )
        name, token = sibling_name(endpoint, number), secrets.token_hex(32)
        unused = sa.and_(db.tokens.c.process == name, db.tokens.c.used.is_(False))

        def put(connection: sa.Connection) -> None:
            connection.execute(db.tokens.delete().where(unused))
            row = {"digest": digest(token), "process": name, "role": "robot", "used": False}
            connection.execute(db.tokens.insert(), row)

        await self._store.run(put)
        return JoinToken(name, token)

    async def redeem(self, machine: str, invitation: str, public_key: str) -> bool:
        """Use up an invitation; return whether it was valid.

        It stays valid for the key of this digest, whose owner may have missed the answer.
        """
        where = sa.and_(
            db.tokens.c.digest == invitation,
            db.tokens.c.process == machine,
            db.tokens.c.role == MACHINE,
            sa.or_(db.tokens.c.used.is_(False), db.tokens.c.public_key == public_key),
        )
        statement = db.tokens.update().where(where).values(used=True, public_key=public_key)
        return bool(await self._store.run(lambda connection: connection.execute(statement).rowcount))

    async def admit(self, process: str, role: str, secret: str, own: str = "") -> str:
        """Return the credential of a process that presents a join token or its credential.

        With a join token it may present its `own` credential, which it made itself. Then it may repeat this until it
        gets the answer; without, the answer has the only copy of a new one.

        Raises:
            Unauthorized: The secret is unknown or was used.
            InvalidRequest: The process's own credential can be guessed.
        """
        if own and len(own) < LEAST_LENGTH:
            raise InvalidRequest(f"a credential has at least {LEAST_LENGTH} random characters", field="credential")
        fresh = own or secrets.token_hex(32)
        if role == MACHINE:
            raise Unauthorized("an invitation is for a machine, not for a process")

        def find(connection: sa.Connection) -> str | None:
            known = connection.execute(_CREDENTIAL, {"process": process}).first()
            for presented in (secret, own):
                if known is not None and known.role == role and secrets.compare_digest(known.digest, digest(presented)):
                    return presented
            return None

        def redeem(connection: sa.Connection) -> str | None:
            if found := find(connection):  # stored since it was looked for
                return found
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

        # Thousands come back at once when the Master has been started again, and all have their credentials.
        credential = await self._store.read(find) or await self._store.run(redeem)
        if credential is None:
            raise Unauthorized(f"{role} {process} may not join: its token is unknown or was used; get a new one")
        return credential

    async def names(self) -> list[str]:
        """Return the processes that have joined at least once, without environments."""
        query = sa.select(db.credentials.c.process).where(db.credentials.c.role != "environment")
        return await self._store.read(lambda connection: sorted(connection.scalars(query)))

    async def remove_machine(self, machine: str) -> None:
        """Revoke the credentials of a machine's processes, its invitation, and its certificate.

        Raises:
            NotFound: There is no such machine.
        """
        processes = [machine, *(process_name(machine, role) for role in get_args(MachineRole))]
        processes += [sibling_name(process_name(machine, "robot"), number) for number in SIBLINGS]
        removed, now = db.removed_machines, time.time()

        def remove(connection: sa.Connection) -> bool:
            if not _drop(connection, processes):
                return False
            expired = removed.c.time < now - MACHINE_DAYS * DAY  # as all certificates from before
            connection.execute(removed.delete().where(sa.or_(removed.c.name == machine, expired)))
            connection.execute(removed.insert(), {"name": machine, "time": now})
            return True

        if not await self._store.run(remove):
            raise NotFound(
                f"there is no machine {machine[:80]!r}: `rce machine list` names those that have joined", field="name"
            )

    async def removals(self) -> dict[str, float]:
        """Return when machines were removed, in seconds since 1970: their certificates from before are refused."""
        query = sa.select(db.removed_machines)
        return await self._store.read(lambda connection: {row.name: row.time for row in connection.execute(query)})

    async def forget(self, *processes: str) -> bool:
        """Revoke the credentials and the tokens of processes; return whether there were any."""
        return await self._store.run(lambda connection: _drop(connection, processes))

    async def keep_environments(self, names: Collection[str]) -> None:
        """Revoke the credentials and the tokens of all environments but these."""

        def drop(connection: sa.Connection) -> None:
            known: set[str] = set()
            for table in (db.credentials, db.tokens):
                known |= {*connection.scalars(sa.select(table.c.process).where(table.c.role == "environment"))}
            _drop(connection, known.difference(names))

        await self._store.run(drop)


def _drop(connection: sa.Connection, processes: Collection[str]) -> bool:
    rows = [{"name": each} for each in processes]
    dropped = [
        connection.execute(table.delete().where(table.c.process == sa.bindparam("name")), rows).rowcount
        for table in (db.credentials, db.tokens)
        if rows
    ]
    return any(dropped)
