"""The row of a PostgreSQL database that the leading Master holds."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from typing import NamedTuple, TypeVar

import sqlalchemy as sa

from master.storage.lease import Lease, not_leading
from master.storage.postgresql import connect
from master.storage.tables import leader
from rce.errors import Unavailable

TIMEOUT = 2  # seconds for a connection, and for an answer of a database that is cut off: several tries fit the lease
_NOW = sa.func.clock_timestamp()  # PostgreSQL's now() is the begin of the transaction, which may have waited for a lock

R = TypeVar("R")


class Held(NamedTuple):
    """What a renewal changes: the term, and the time until which the row is held."""

    term: int
    until: datetime


class LeaderRow:
    """The row, over a connection of its own: neither waits for the transactions of the store."""

    def __init__(self, url: sa.URL, holder: str, clock: Callable[[], float] = time.monotonic) -> None:
        """Prepare access to the row.

        Args:
            url: URL of the database.
            holder: Identity of this Master, the same after its restart: it need not wait for its own lease to end.
            clock: Source of the time in seconds.
        """
        self._engine = connect(url, TIMEOUT)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="lease")
        self._holder = holder
        self._clock = clock
        self._seen: Held | None = None  # of another Master
        self._seen_since = 0.0

    async def take(self, url: str, seconds: float) -> tuple[int, str]:
        """Take the row for some seconds if it is free, as `Row.take`.

        It is also free if it was not renewed for as long by the clock of this Master: that of the database may have
        jumped back. This waits until no transaction of the last leader is under way. Its database ends those that are
        idle.
        """
        abandoned = self._seen if self._clock() - self._seen_since >= seconds else None
        term, leads, held = await self._do(lambda connection: _take(connection, self._holder, url, seconds, abandoned))
        if held != self._seen:
            self._seen, self._seen_since = held, self._clock()
        return term, leads

    async def renew(self, term: int, seconds: float) -> bool:
        """Hold the row for some seconds more, as `Row.renew`."""
        return await self._do(lambda connection: _renew(connection, term, seconds))

    async def release(self, term: int) -> None:
        """Free the row, as `Row.release`."""
        await self._do(lambda connection: _renew(connection, term, 0.0))

    async def _do(self, work: Callable[[sa.Connection], R]) -> R:
        def transact() -> R:
            try:
                with self._engine.begin() as connection:
                    return work(connection)
            except sa.exc.SQLAlchemyError as error:
                self._engine.dispose()  # after a fail-over of PostgreSQL the connection may be to its old primary
                reason = str(getattr(error, "orig", None) or error).partition("\n")[0]
                raise Unavailable(f"the database does not answer: {reason}") from None

        return await asyncio.get_running_loop().run_in_executor(self._thread, transact)

    def close(self) -> None:
        """Close the connection."""
        self._thread.shutdown(wait=False, cancel_futures=True)
        self._engine.dispose()


def fence(lease: Lease) -> Callable[[sa.Connection], None]:
    """Return a check that a transaction makes at its begin: the term of the lease is the last one until its end."""
    loop = asyncio.get_running_loop()

    def check(connection: sa.Connection) -> None:
        if connection.execute(_CHECK, {"held": lease.term}).first() is None:
            loop.call_soon_threadsafe(lease.lose, "another Master leads")
            raise not_leading("")

    return check


# A lock of the key (PostgreSQL: FOR KEY SHARE), with which renewals do not collide.
_CHECK = sa.select(leader.c.id).where(leader.c.term == sa.bindparam("held")).with_for_update(read=True, key_share=True)


def _take(
    connection: sa.Connection, holder: str, url: str, seconds: float, abandoned: Held | None
) -> tuple[int, str, Held | None]:
    """Take the row; return the term and the URL as `Row.take`, and how another Master holds it."""
    columns = leader.c.holder, leader.c.url, leader.c.term, leader.c.until, (leader.c.until > _NOW).label("lasts")
    found = connection.execute(sa.select(*columns)).first()
    if found is not None and found.holder != holder and found.lasts:
        held = Held(found.term, found.until)
        if held != abandoned:
            return 0, str(found.url), held
    # Terms are at least the seconds since 1970, so that they also grow when the database is restored from a backup.
    age = sa.cast(sa.func.extract("epoch", _NOW), sa.BigInteger)
    values = {"term": sa.func.greatest(leader.c.term + 1, age), "holder": holder, "url": url}
    free = [leader.c.holder == holder, leader.c.until <= _NOW]
    if abandoned is not None:
        free.append(sa.and_(leader.c.term == abandoned.term, leader.c.until == abandoned.until))
    taken = connection.execute(
        leader.update().where(sa.or_(*free)).values(**values, until=_later(seconds)).returning(leader.c.term)
    ).scalar()
    return (int(taken), url, None) if taken is not None else (0, "", None)


def _renew(connection: sa.Connection, term: int, seconds: float) -> bool:
    renewed = connection.execute(leader.update().where(leader.c.term == term).values(until=_later(seconds)))
    return renewed.rowcount == 1


def _later(seconds: float) -> sa.ColumnElement[object]:
    return _NOW + sa.func.make_interval(0, 0, 0, 0, 0, 0, seconds)


def create(connection: sa.Connection) -> None:
    """Make the table with its row, before the database is migrated: only the leader may do that."""
    connection.execute(sa.text("SELECT pg_advisory_xact_lock(hashtext('rce leader'))"))  # two Masters may begin at once
    leader.create(connection, checkfirst=True)
    if connection.execute(sa.select(leader.c.id)).first() is None:
        connection.execute(leader.insert().values(id=1, term=0, holder="", url="", until=_NOW))
