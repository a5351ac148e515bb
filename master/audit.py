"""The audit log: who did what to what, from where, with what result. Entries are added and never changed.

They are written together in the database's thread, so that commands do not wait for them. What the Master noted in its
last milliseconds is lost if it is killed.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, get_args

import sqlalchemy as sa
from msgspec import Struct
from twisted.logger import Logger

from master import store as db
from rce.errors import RceError
from rce.messages import Command
from rce.names import MAX_TAG
from rce.roles import Principal
from rce.views import AuditView

DAY = 86_400.0
MOST_WAITING = 100_000  # entries that a database which fails may leave in memory
STRANGERS = 600  # refusals a minute that are noted of those who did not prove who they are: they must not fill the disk
LONGEST = 1500  # characters of an object
NAMES = ("containerTag", "endpointTag", "nodeTag", "interfaceTag", "tagA", "tagB", "name", "role", "label", "users")
"""Fields that name what a command or a request is about, in the order in which they are noted."""

log = Logger()


class Origin(Struct, frozen=True):
    """By which door somebody came, and from which address."""

    door: str
    address: str = ""


class Wanted(Struct, frozen=True):
    """Which entries; what is empty or None does not matter. `concerning` did it, or had it done to their things."""

    user: str = ""
    action: str = ""
    object: str = ""
    result: str = ""
    since: float | None = None
    until: float | None = None
    concerning: str | None = None


class Noted(Struct):
    """Whose it is, and who does it, once that is known."""

    owner: str
    who: Principal | None = None
    quiet: bool = False  # noted only if it is refused or fails


class Audit:
    """Entries on their way to the database, and those that are there."""

    def __init__(self, store: db.Store) -> None:
        self._store = store
        self._waiting: list[dict[str, Any]] = []
        self._write: asyncio.Task[None] | None = None
        self._minute = 0  # since 1970
        self._strangers = 0  # refusals in it

    def note(
        self,
        who: Principal | None,
        action: str,
        owner: str,
        thing: str,
        origin: Origin,
        error: BaseException | None = None,
    ) -> None:
        """Something was done to what is `owner`'s; `error` is why it was refused or failed, `who` is None if they did
        not prove who they are.
        """
        if who is None and not self._may_note_stranger():
            return
        entry = {
            "time": time.time(),
            "user": who.user if who else "",
            "key": who.key if who else "",
            "owner": _text(owner, MAX_TAG),
            "action": action,
            "object": _text(thing, LONGEST),
            "result": _result(error),
            "door": origin.door,
            "address": origin.address[:64],
        }
        if len(self._waiting) >= MOST_WAITING:
            log.error("the audit log cannot be written: {entry}", entry=entry)
            return
        self._waiting.append(entry)
        if self._write is None or self._write.done():
            self._write = asyncio.create_task(self._write_all())

    @contextmanager
    def noting(self, action: str, owner: str, thing: str, origin: Origin) -> Iterator[Noted]:
        """Note how what is done within ends, by whoever is set as `who`."""
        noted = Noted(owner)
        try:
            yield noted
        except BaseException as error:
            self.note(noted.who, action, noted.owner, thing, origin, error)
            raise
        if not noted.quiet:
            self.note(noted.who, action, noted.owner, thing, origin)

    def _may_note_stranger(self) -> bool:
        minute = int(time.time() / 60)
        if minute != self._minute:
            self._minute, self._strangers = minute, 0
        self._strangers += 1
        if self._strangers == STRANGERS:
            log.warn("more than {most} refusals a minute: the rest is not noted", most=STRANGERS)
        return self._strangers < STRANGERS

    async def _write_all(self) -> None:
        await asyncio.sleep(0)  # what happens at once is written together
        while self._waiting:
            entries, self._waiting = self._waiting, []
            try:
                await self._store.run(partial(_insert, entries))
            except sa.exc.SQLAlchemyError as error:
                self._waiting = entries + self._waiting
                log.error("the audit log waits for the database: {error}", error=str(error))
                return

    async def flush(self) -> None:
        """Returns once all is written."""
        if self._write is None or self._write.done():
            self._write = asyncio.create_task(self._write_all())
        await self._write

    async def find(self, wanted: Wanted, before: int | None, limit: int) -> list[AuditView]:
        """The newest first: those older than the entry `before`."""
        await self.flush()
        table = db.audit
        query = sa.select(table).order_by(table.c.id.desc()).limit(limit)
        for name in ("user", "action", "result"):
            if value := getattr(wanted, name):
                query = query.where(table.c[name] == value)
        if wanted.object:
            below = table.c.object.startswith(f"{wanted.object}/", autoescape=True)
            query = query.where(sa.or_(table.c.object == wanted.object, below))
        if wanted.since is not None:
            query = query.where(table.c.time >= wanted.since)
        if wanted.until is not None:
            query = query.where(table.c.time < wanted.until)
        if wanted.concerning is not None:
            query = query.where(sa.or_(table.c.user == wanted.concerning, table.c.owner == wanted.concerning))
        if before is not None:
            query = query.where(table.c.id < before)
        rows = await self._store.run(lambda connection: list(connection.execute(query)))
        return [AuditView(**{name: getattr(row, name) for name in AuditView.__struct_fields__}) for row in rows]

    async def forget(self, days: float) -> None:
        """Remove what is older; 0: nothing is ever removed."""
        if days:
            old = db.audit.delete().where(db.audit.c.time < time.time() - days * DAY)
            await self._store.run(lambda connection: connection.execute(old))

    async def tidy(self, days: float) -> None:
        """Forget what is older, now and each day, until cancelled."""
        while True:
            try:
                await self.forget(days)
            except sa.exc.SQLAlchemyError as error:
                log.warn("old entries of the audit log stay: {error}", error=str(error))
            await asyncio.sleep(DAY)


def _insert(entries: list[dict[str, Any]], connection: sa.Connection) -> None:
    connection.execute(db.audit.insert(), entries)


def _text(said: str, longest: int) -> str:
    """What anybody may have said, as every database takes it: PostgreSQL has no text with NUL."""
    return said[:longest].replace("\0", "\ufffd")


def _result(error: BaseException | None) -> str:
    if isinstance(error, RceError):
        return error.info.code
    if isinstance(error, asyncio.CancelledError):
        return "cancelled"
    return "ok" if error is None else "internal"


def names_of(thing: object) -> list[str]:
    """What a command or the body of a request is about."""
    found = [value for name in NAMES if (value := getattr(thing, name, ""))]
    return [",".join(value) if isinstance(value, list) else str(value) for value in found]


def object_of(user: str, command: Command) -> str:
    """What a command is about, as `user/environment/node`."""
    assert isinstance(command, get_args(Command))
    return "/".join([user, *names_of(command)])
