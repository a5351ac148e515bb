"""Store: the database of the Master, SQLite or PostgreSQL through SQLAlchemy.

One worker thread owns the database, so that writes keep their order and the event loop never waits for a disk. What
comes during a transaction shares the next one, and so one flush to the disk: records that changed, and other work, of
which each piece that writes has a savepoint.

A transaction whose connection is lost before its commit runs again. If it is lost during the commit, nobody knows
whether it was stored: only work that may be repeated runs again then.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sqlite3
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
import sqlalchemy as sa
from sqlalchemy.pool import StaticPool
from twisted.logger import Logger

from master.graph.state import State
from master.storage import postgresql
from master.storage.migration import upgrade
from master.storage.tables import records
from rce.errors import DiskFull, InvalidRequest, Unavailable
from rce.process import metrics

log = Logger()
_transactions = metrics.Timing("rce_database_seconds", "Time of a transaction, with waiting for the one before")
PATIENCE = 5.0  # seconds
FAILURES = (sa.exc.SQLAlchemyError, DiskFull, Unavailable)  # what a database raises that does not work
MAX_TOGETHER = 100  # pieces of work in one transaction
RETRY_INTERVAL = 0.2  # seconds until a transaction runs again whose connection was lost, for PATIENCE
# Made once, because SQLAlchemy takes long to make a statement. SQLite and PostgreSQL both know ON CONFLICT.
_REMOVE = records.delete().where(records.c.kind == sa.bindparam("kind"), records.c.key == sa.bindparam("key"))
_PUT = sa.text(
    "INSERT INTO records (kind, key, value) VALUES (:kind, :key, :value)"
    " ON CONFLICT (kind, key) DO UPDATE SET value = excluded.value"
)
R = TypeVar("R")
Outcome = tuple[Any, Exception | None]


class Work(NamedTuple):
    """A piece of work, and who waits for its result.

    Attributes:
        run: The work.
        done: Resolves with its result.
        repeatable: It may run again after it was committed.
        writes: It may have to be undone without the others of its transaction.
    """

    run: Callable[[sa.Connection], Any]
    done: asyncio.Future[Any]
    repeatable: bool
    writes: bool


class UnknownOutcome(Unavailable):
    """The connection to the database was lost during a commit. Look at what is there, and try again."""


class Store:
    """A database; `url` is SQLAlchemy's (`sqlite:////var/lib/rce/master.db`, `postgresql+psycopg://…`).

    Attributes:
        url: The URL.
        fence: Called at the begin of each transaction; it raises an error if this Master may not use the database.
    """

    def __init__(self, url: str) -> None:
        self.fence: Callable[[sa.Connection], None] | None = None
        try:
            self.url = parsed = sa.make_url(url)
            memory = parsed.get_backend_name() == "sqlite" and parsed.database in (None, "", ":memory:")
            if self.shared:
                self._engine = postgresql.connect(parsed, int(PATIENCE))
            else:
                self._engine = sa.create_engine(parsed, **({"poolclass": StaticPool} if memory else {}))
        except (sa.exc.ArgumentError, sa.exc.NoSuchModuleError, ModuleNotFoundError) as error:
            raise InvalidRequest(f"database {url!r} cannot be used: {error}", field="database") from None
        if parsed.get_backend_name() == "sqlite":
            if not memory and not str(parsed.database).startswith("file:"):  # SQLite's own URIs are left alone
                _make_private(Path(str(parsed.database)))
            sa.event.listen(self._engine, "connect", _tune_sqlite)
            sa.event.listen(self._engine, "begin", _begin_sqlite)
        self._connection: sa.Connection | None = None
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="store")
        self._works: deque[Work] = deque()
        self._waiting: dict[tuple[str, str], str | None] = {}
        self._batch: asyncio.Future[None] | None = None  # resolves when what waits now is stored
        self._under_way: asyncio.Future[None] | None = None  # the batch that is being written
        self._flush: asyncio.Task[None] | None = None
        self._check: asyncio.Future[Any] | None = None

    @property
    def shared(self) -> bool:
        """True if several Masters may use this database."""
        return self.url.get_backend_name() == "postgresql"

    async def open(self) -> None:
        """Create the tables, or migrate them to this version.

        Raises:
            InvalidRequest: The database cannot be opened or migrated.
        """
        try:
            await self._do(lambda: upgrade(self._engine, self.fence))
        except sa.exc.SQLAlchemyError as error:
            raise self._unusable(error) from None

    async def prepare(self, create: Callable[[sa.Connection], None]) -> None:
        """Make what must be there before the database is opened.

        Raises:
            InvalidRequest: The database cannot be used.
        """

        def transact() -> None:
            with self._engine.begin() as connection:
                create(connection)

        try:
            await self._do(transact)
        except sa.exc.SQLAlchemyError as error:
            raise self._unusable(error) from None

    def _unusable(self, error: sa.exc.SQLAlchemyError) -> InvalidRequest:
        advice = (
            "check that it runs and admits this Master"
            if self.shared
            else "check that its disk has room and that the file may be written, or put a backup in its place"
        )
        return InvalidRequest(
            f"database {self.url!r} cannot be opened: {_reason(error)}; {advice} (docs/operations.md)", field="database"
        )

    async def run(self, work: Callable[[sa.Connection], R], *, repeatable: bool = False) -> R:
        """Run `work` in the database's thread; return its result when it is stored, or nothing of it if it fails.

        `work` may be run a second time after it was rolled back, and after it was committed if it is `repeatable`.

        Raises:
            InvalidRequest: The database cannot hold a value, as PostgreSQL text with NUL.
            DiskFull: There is no room for what it writes.
            UnknownOutcome: The connection was lost during the commit.
            Unavailable: The database cannot be reached, or another Master leads.
        """
        result: R = await self._await(work, repeatable, writes=True)
        return result

    async def read(self, work: Callable[[sa.Connection], R]) -> R:
        """Run `work`, which only reads, in the database's thread. Many at once cost less than by `run`.

        Raises:
            InvalidRequest: The database cannot hold a value, as PostgreSQL text with NUL.
            Unavailable: The database cannot be reached, or another Master leads.
        """
        result: R = await self._await(work, repeatable=True, writes=False)
        return result

    async def _await(self, run: Callable[[sa.Connection], Any], repeatable: bool, writes: bool) -> Any:
        began = time.perf_counter()
        done = asyncio.get_running_loop().create_future()
        self._works.append(Work(run, done, repeatable, writes))
        self._thread.submit(self._serve)
        try:
            return await done
        except sa.exc.DataError as error:
            raise InvalidRequest(f"the database cannot hold this: {error.orig}") from None
        except sa.exc.OperationalError as error:
            if _is_full(error):
                raise DiskFull.at(f"database: {error.orig}") from None
            if postgresql.is_lost(error):
                raise Unavailable(f"the database cannot be reached: {_reason(error)}; try again") from None
            raise
        finally:
            _transactions.labels().observe_since(began)

    def _serve(self) -> None:
        """Run what waits, in one transaction if possible; called in the thread, once for each piece of work."""
        works = [self._works.popleft() for _ in range(min(MAX_TOGETHER, len(self._works)))]
        works = [work for work in works if not work.done.cancelled()]
        if len(works) > 1:
            try:
                outcomes = self._transact(lambda connection: _run_together(connection, works))
            except Exception as error:  # noqa: BLE001  # the transaction as a whole failed: each gets one of its own
                log.info("{count} transactions are repeated: {error}", count=len(works), error=str(error)[:200])
                if isinstance(error, UnknownOutcome):
                    _settle([(work, (None, error)) for work in works if not work.repeatable])
                    works = [work for work in works if work.repeatable]
            else:
                _settle(list(zip(works, outcomes, strict=True)))
                return
        for work in works:
            outcome: Outcome
            try:
                outcome = self._transact(work.run, work.repeatable), None
            except Exception as error:  # noqa: BLE001  # its caller gets it
                outcome = None, error
            _settle([(work, outcome)])

    def _transact(self, run: Callable[[sa.Connection], R], repeatable: bool = False) -> R:
        """Run in a transaction, and again if its connection is lost before its commit."""
        until = time.monotonic() + PATIENCE
        while True:
            committing = False
            try:
                connection = self._connected()
                with connection.begin():
                    if self.fence is not None:
                        self.fence(connection)
                    result = run(connection)
                    committing = True
                return result
            except sa.exc.SQLAlchemyError as error:
                if not postgresql.is_lost(error):
                    raise
                self._disconnect()  # after a fail-over of PostgreSQL all connections are to its old primary
                if committing and not repeatable:
                    raise UnknownOutcome(
                        f"the database was lost while it stored this: {_reason(error)}; look at what is there"
                    ) from None
                if time.monotonic() > until:
                    raise
                log.info("a transaction is repeated, as the database was lost: {error}", error=_reason(error))
            time.sleep(RETRY_INTERVAL)

    def _connected(self) -> sa.Connection:
        """Return the connection of the thread, which is kept: SQLAlchemy's pool takes half as long as a transaction."""
        if self._connection is None:
            self._connection = self._engine.connect()
        return self._connection

    def _disconnect(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.close()
        self._engine.dispose()

    async def _do(self, work: Callable[[], R]) -> R:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    async def load(self, state: State) -> None:
        """Load all records into an empty state."""
        kinds = {table.kind.__name__: table for table in state.tables()}
        for kind, value in await self.run(lambda db: list(db.execute(sa.select(records.c.kind, records.c.value)))):
            table = kinds[kind]
            table.load(msgspec.json.decode(value, type=table.kind))

    def save(self, state: State) -> asyncio.Future[None]:
        """Begin to write what changed in `state`; the future resolves when it is stored, whatever changes meanwhile.

        It fails with DiskFull if there is no room; what changed is written again with the next change.
        """
        for table in state.tables():
            for key in table.changed:
                record = table.get(key)
                value = None if record is None else msgspec.json.encode(record).decode()
                self._waiting[table.kind.__name__, key] = value
            table.changed.clear()
        loop = asyncio.get_running_loop()
        if self._waiting and self._batch is None:
            self._batch = loop.create_future()
        stored = self._batch or self._under_way
        if self._batch is not None and (self._flush is None or self._flush.done()):
            self._flush = loop.create_task(self._write())
        if stored is not None:
            return asyncio.shield(stored)
        done = loop.create_future()
        done.set_result(None)
        return done

    async def _write(self) -> None:
        """Write batches, until there is none that somebody waits for."""
        while (batch := self._batch) is not None:
            self._batch, self._under_way = None, batch
            rows, self._waiting = self._waiting, {}
            try:
                await self.run(partial(_put, rows=rows), repeatable=True)
            except Exception as error:  # noqa: BLE001  # who waits for the batch gets it
                self._waiting = rows | self._waiting  # written by the next try, unless changed again
                batch.set_exception(error)
                batch.exception()  # it is no defect if nobody waits any more
            else:
                batch.set_result(None)
            self._under_way = None

    async def missing(self) -> list[str]:
        """Return a sentence if the database does not work, else nothing."""
        if self._check is None or self._check.done():  # one check at a time, however many callers
            self._check = asyncio.ensure_future(self.run(lambda db: db.execute(sa.select(1)).scalar()))
        try:
            await asyncio.wait_for(asyncio.shield(self._check), PATIENCE)
        except (TimeoutError, *FAILURES) as error:
            log.warn("the database does not answer: {error}", error=str(error) or f"for {PATIENCE:g} s")
            return ["the database does not answer: what changes is not stored"]
        return []

    async def close(self) -> None:
        """Write what waits and close the database, which it does also if that write fails."""
        try:
            if self._flush is not None:
                await self._flush
            if self._waiting:
                await self.run(partial(_put, rows=self._waiting), repeatable=True)
        finally:
            await self._do(self._disconnect)
            self._thread.shutdown()


def _run_together(connection: sa.Connection, works: list[Work]) -> list[Outcome]:
    """Run works in one transaction; return their results or errors."""
    outcomes: list[Outcome] = []
    for work in works:
        try:
            with connection.begin_nested() if work.writes else contextlib.nullcontext():
                outcomes.append((work.run(connection), None))
        except sa.exc.SQLAlchemyError as error:
            # A full disk, or a lost connection. And no savepoint ends the failure of what only reads.
            if isinstance(error, sa.exc.OperationalError) or not work.writes:
                raise
            outcomes.append((None, error))
        except Exception as error:  # noqa: BLE001  # its caller gets it
            outcomes.append((None, error))
    return outcomes


def _reason(error: sa.exc.SQLAlchemyError) -> str:
    """Return the reason in one line, without SQLAlchemy's own advice."""
    return str(getattr(error, "orig", None) or error).partition("\n")[0]


def _settle(outcomes: list[tuple[Work, Outcome]]) -> None:
    """Pass outcomes on to those who wait; called in the database's thread."""
    if outcomes:
        outcomes[0][0].done.get_loop().call_soon_threadsafe(_resolve, outcomes)


def _resolve(outcomes: list[tuple[Work, Outcome]]) -> None:
    for work, (result, error) in outcomes:
        if work.done.done():  # nobody waits any more
            continue
        if error is not None:
            work.done.set_exception(error)
        else:
            work.done.set_result(result)


def _put(connection: sa.Connection, rows: dict[tuple[str, str], str | None]) -> None:
    gone = [{"kind": kind, "key": key} for (kind, key), value in rows.items() if value is None]
    if gone:
        connection.execute(_REMOVE, gone)
    present = [{"kind": kind, "key": key, "value": value} for (kind, key), value in rows.items() if value is not None]
    if present:
        connection.execute(_PUT, present)


def _is_full(error: sa.exc.OperationalError) -> bool:
    """Return whether a database has no room: SQLite, and the disk of a PostgreSQL server."""
    code = getattr(error.orig, "sqlite_errorcode", None)
    return code == sqlite3.SQLITE_FULL or getattr(error.orig, "sqlstate", "") == "53100"


def _make_private(file: Path) -> None:
    """Create the file with mode 0600, because it has hashes of passwords. SQLite's other files get the same mode."""
    with contextlib.suppress(OSError):  # opening it reports the error
        file.touch(mode=0o600)
        if file.stat().st_uid == os.geteuid():
            file.chmod(0o600)


def _begin_sqlite(connection: sa.Connection) -> None:
    connection.connection.cursor().execute("BEGIN")


def _tune_sqlite(connection: Any, _: object) -> None:
    connection.isolation_level = None  # the driver's own BEGIN comes too late for savepoints: `_begin_sqlite`
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")  # a power cut loses nothing that was acknowledged
    connection.execute("PRAGMA foreign_keys=ON")
