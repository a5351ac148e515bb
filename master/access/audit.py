"""Audit log: who did what to what, from where, with what result. Entries are added and never changed.

Entries are written in batches in the database's thread, so that commands do not wait for them. If the Master is killed,
the entries of the last `COLLECTING` seconds are lost.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import sqlalchemy as sa
from msgspec import Struct
from twisted.logger import Logger

from master.storage import tables as db
from master.storage.store import FAILURES, Store
from rce.api.roles import Principal
from rce.api.views import AuditView
from rce.errors import RceError
from rce.protocol.messages import Command
from rce.protocol.names import MAX_TAG

DAY = 86_400.0
COLLECTING = 0.05  # seconds for which entries are collected; one transaction for each would delay the next command
MAX_WAITING = 100_000  # entries in memory while the database fails
MAX_UNAUTHENTICATED = 600  # entries a minute of unauthenticated clients, which must not fill the disk
MAX_OBJECT = 1500  # characters
NAMES = (
    "containerTag",
    "endpointTag",
    "nodeTag",
    "recorderTag",
    "interfaceTag",
    "tagA",
    "tagB",
    "service",
    "name",
    "role",
    "label",
    "users",
)
"""Fields that name what a command or a request is about, in the order in which they are noted."""

log = Logger()


class Origin(Struct, frozen=True):
    """Interface of the platform and address from which something was done."""

    door: str
    address: str = ""


class AuditFilter(Struct, frozen=True):
    """Filter of entries; empty and None match all. `concerning` is a user who did it or who owns the object."""

    user: str = ""
    action: str = ""
    object: str = ""
    result: str = ""
    since: float | None = None
    until: float | None = None
    concerning: str | None = None


class AuditedAction(Struct):
    """An action in progress: the owner of its object, and who does it as soon as that is known."""

    owner: str
    who: Principal | None = None
    quiet: bool = False  # written only if it is refused or fails


class Audit:
    """Writes entries, and finds them."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._waiting: list[dict[str, Any]] = []
        self._timer: asyncio.TimerHandle | None = None  # while entries are collected
        self._write: asyncio.Task[None] | None = None
        self._minute = 0  # since 1970
        self._unauthenticated = 0  # entries in this minute

    def note(
        self,
        who: Principal | None,
        action: str,
        owner: str,
        thing: str,
        origin: Origin,
        error: BaseException | None = None,
    ) -> None:
        """Write an entry about something of `owner`.

        `error` is the reason why it was refused or failed. `who` is None if they did not authenticate.
        """
        if who is None and not self._may_write_unauthenticated():
            return
        entry = {
            "time": time.time(),
            "user": who.user if who else "",
            "key": who.key if who else "",
            "owner": _text(owner, MAX_TAG),
            "action": action,
            "object": _text(thing, MAX_OBJECT),
            "result": _result(error),
            "door": origin.door,
            "address": origin.address[:64],
        }
        if len(self._waiting) >= MAX_WAITING:
            log.error("the audit log cannot be written: {entry}", entry=entry)
            return
        self._waiting.append(entry)
        if self._timer is None and not self._writing:
            self._timer = asyncio.get_running_loop().call_later(COLLECTING, self._begin)

    @contextmanager
    def auditing(self, action: str, owner: str, thing: str, origin: Origin) -> Iterator[AuditedAction]:
        """Write an entry about the action in this context when it ends; set `who` on the result once it is known."""
        noted = AuditedAction(owner)
        try:
            yield noted
        except BaseException as error:
            self.note(noted.who, action, noted.owner, thing, origin, error)
            raise
        if not noted.quiet:
            self.note(noted.who, action, noted.owner, thing, origin)

    def _may_write_unauthenticated(self) -> bool:
        minute = int(time.time() / 60)
        if minute != self._minute:
            self._minute, self._unauthenticated = minute, 0
        self._unauthenticated += 1
        if self._unauthenticated == MAX_UNAUTHENTICATED + 1:
            log.warn(
                "more than {most} entries a minute of unauthenticated clients: the rest is dropped",
                most=MAX_UNAUTHENTICATED,
            )
        return self._unauthenticated <= MAX_UNAUTHENTICATED

    @property
    def _writing(self) -> bool:
        return self._write is not None and not self._write.done()

    def _begin(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._write = asyncio.create_task(self._write_all())

    async def _write_all(self) -> None:
        while self._waiting:
            entries, self._waiting = self._waiting, []
            try:
                await self._store.run(partial(_insert, entries))
            except FAILURES as error:
                self._waiting = entries + self._waiting
                log.error("the audit log waits for the database: {error}", error=str(error))
                return

    async def flush(self) -> None:
        """Return when all entries are written."""
        if self._waiting and not self._writing:
            self._begin()
        if self._write is not None:
            await asyncio.shield(self._write)  # who waits may be cancelled, and the entries must be written

    async def find(self, wanted: AuditFilter, before: int | None, limit: int) -> list[AuditView]:
        """Return entries that match, newest first, beginning after the entry with id `before`."""
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
        rows = await self._store.read(lambda connection: list(connection.execute(query)))
        return [AuditView(**{name: getattr(row, name) for name in AuditView.__struct_fields__}) for row in rows]

    async def forget(self, days: float) -> None:
        """Remove entries older than `days`; 0 keeps all."""
        if days:
            old = db.audit.delete().where(db.audit.c.time < time.time() - days * DAY)
            await self._store.run(lambda connection: connection.execute(old))

    async def tidy(self, days: float) -> None:
        """Remove old entries now and every day, until cancelled."""
        while True:
            try:
                await self.forget(days)
            except FAILURES as error:
                log.warn("old entries of the audit log stay: {error}", error=str(error))
            await asyncio.sleep(DAY)


def _insert(entries: list[dict[str, Any]], connection: sa.Connection) -> None:
    connection.execute(db.audit.insert(), entries)


def _text(text: str, length: int) -> str:
    """Cut text, and replace NUL, which PostgreSQL cannot store."""
    return text[:length].replace("\0", "\ufffd")


def _result(error: BaseException | None) -> str:
    if isinstance(error, RceError):
        return error.info.code
    if isinstance(error, asyncio.CancelledError):
        return "cancelled"
    return "ok" if error is None else "internal"


def names_of(thing: object) -> list[str]:
    """Return the names in a command or request body."""
    found = [value for name in NAMES if (value := getattr(thing, name, ""))]
    return [",".join(value) if isinstance(value, list) else str(value) for value in found]


def object_of(user: str, command: Command) -> str:
    """Return the object of a command, as `user/environment/node`."""
    return "/".join([user, *names_of(command)])
