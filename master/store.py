"""What outlives the Master, in SQLite or PostgreSQL through SQLAlchemy: the graph's records, users, keys, tokens.

One worker thread owns the database, so writes keep their order and the event loop never waits for a disk. Records
changed while a write is under way go together in the next one.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import sqlalchemy as sa
from sqlalchemy.pool import StaticPool
from twisted.logger import Logger

from master.migration import bring_up_to_date
from master.records import State
from rce import metrics
from rce.errors import InvalidRequest

log = Logger()
_transactions = metrics.Timing("rce_database_seconds", "Time of a transaction, with waiting for the one before")
PATIENCE = 5.0  # seconds
R = TypeVar("R")
tables = sa.MetaData()

records = sa.Table(
    "records",
    tables,
    sa.Column("kind", sa.String(32), primary_key=True),
    sa.Column("key", sa.String(1600), primary_key=True),  # of a connection: six names of 255
    sa.Column("value", sa.Text, nullable=False),
)
users = sa.Table(
    "users",
    tables,
    sa.Column("name", sa.String(255), primary_key=True),
    sa.Column("password", sa.Text, nullable=False),  # argon2 of the SHA-256 hex
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("created", sa.Float, nullable=False),
)
api_keys = sa.Table(
    "api_keys",
    tables,
    sa.Column("digest", sa.String(64), primary_key=True),  # SHA-256 of the key
    sa.Column("id", sa.String(32), unique=True, nullable=False),
    sa.Column("user", sa.String(255), sa.ForeignKey("users.name", ondelete="CASCADE"), index=True, nullable=False),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("label", sa.Text, nullable=False),
    sa.Column("created", sa.Float, nullable=False),
    sa.Column("expires", sa.Float),
    sa.Column("used", sa.Float),
    sa.Column("scopes", sa.Text),  # JSON; none: not narrowed
)
limits = (
    sa.Table(  # of users who do not have those of the platform; what the running Master takes for these stands at ""
        "limits",
        tables,
        sa.Column("user", sa.String(255), primary_key=True),
        sa.Column("value", sa.Text, nullable=False),
    )
)
grants = sa.Table(  # rights of services to act for users: gone with the user, or the API key that they were given with
    "grants",
    tables,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("service", sa.String(600), nullable=False),
    sa.Column("user", sa.String(255), sa.ForeignKey("users.name", ondelete="CASCADE"), index=True, nullable=False),
    sa.Column("key", sa.String(32), sa.ForeignKey("api_keys.id", ondelete="CASCADE"), index=True),  # none: a password
    sa.Column("created", sa.Float, nullable=False),
    sa.Column("lent", sa.String(64), unique=True),  # SHA-256 of the key that the service has now
    sa.Column("expires", sa.Float),  # of that key
)
credentials = sa.Table(  # of processes: what they got for their join token
    "credentials",
    tables,
    sa.Column("process", sa.String(600), primary_key=True),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("digest", sa.String(64), nullable=False),
)
tokens = sa.Table(  # one-time join tokens; a used one stays, so that it is not taken for a new one
    "tokens",
    tables,
    sa.Column("digest", sa.String(64), primary_key=True),
    sa.Column("process", sa.String(600), nullable=False),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("used", sa.Boolean, nullable=False),
)
audit = sa.Table(  # rows are added, and those that are too old removed; nothing changes them
    "audit",
    tables,
    sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("time", sa.Float, index=True, nullable=False),
    sa.Column("user", sa.String(255), index=True, nullable=False),
    sa.Column("key", sa.String(32), nullable=False),
    sa.Column("owner", sa.String(255), index=True, nullable=False),
    sa.Column("action", sa.String(64), nullable=False),
    sa.Column("object", sa.Text, nullable=False),
    sa.Column("result", sa.String(64), nullable=False),
    sa.Column("door", sa.String(16), nullable=False),
    sa.Column("address", sa.String(64), nullable=False),
)


class Store:
    """`url` is SQLAlchemy's (`sqlite:////var/lib/rce/master.db`, `postgresql+psycopg://…`)."""

    def __init__(self, url: str) -> None:
        try:
            parsed = sa.make_url(url)
            memory = parsed.get_backend_name() == "sqlite" and parsed.database in (None, "", ":memory:")
            self._engine = sa.create_engine(parsed, **({"poolclass": StaticPool} if memory else {}))
        except (sa.exc.ArgumentError, sa.exc.NoSuchModuleError, ModuleNotFoundError) as error:
            raise InvalidRequest(f"database {url!r} cannot be used: {error}", field="database") from None
        if parsed.get_backend_name() == "sqlite":
            if not memory and not str(parsed.database).startswith("file:"):  # a URI of SQLite's own is for who knows it
                _make_private(Path(str(parsed.database)))
            sa.event.listen(self._engine, "connect", _tune_sqlite)
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="store")
        self._waiting: dict[tuple[str, str], str | None] = {}
        self._flush: asyncio.Task[None] | None = None
        self._check: asyncio.Future[Any] | None = None

    async def open(self) -> None:
        """Make the tables and columns that are missing."""
        try:
            await self._do(lambda: bring_up_to_date(self._engine, tables))
        except sa.exc.SQLAlchemyError as error:
            told = str(getattr(error, "orig", None) or error).partition("\n")[0]  # without SQLAlchemy's own advice
            raise InvalidRequest(
                f"database {self._engine.url!r} cannot be opened: {told}; see that its disk has room and that the file "
                "may be written, or put a backup in its place (docs/operations.md)",
                field="database",
            ) from None

    async def run(self, work: Callable[[sa.Connection], R]) -> R:
        """`work` in a transaction of its own, in the database's thread. InvalidRequest for values that it cannot hold:
        in PostgreSQL, text with NUL.
        """

        def transact() -> R:
            with self._engine.begin() as connection:
                return work(connection)

        began = time.perf_counter()
        try:
            return await self._do(transact)
        except sa.exc.DataError as error:
            raise InvalidRequest(f"the database cannot hold this: {error.orig}") from None
        finally:
            _transactions.of().since(began)

    async def _do(self, work: Callable[[], R]) -> R:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    async def load(self, state: State) -> None:
        """Fill an empty state."""
        kinds = {table.kind.__name__: table for table in state.tables()}
        for kind, value in await self.run(lambda db: list(db.execute(sa.select(records.c.kind, records.c.value)))):
            table = kinds[kind]
            table.load(msgspec.json.decode(value, type=table.kind))

    async def save(self, state: State) -> None:
        """Write what changed in `state`; returns once it is safe."""
        for table in state.tables():
            for key in table.changed:
                record = table.get(key)
                value = None if record is None else msgspec.json.encode(record).decode()
                self._waiting[table.kind.__name__, key] = value
            table.changed.clear()
        if self._flush is None or self._flush.done():
            self._flush = asyncio.create_task(self._write())
        await asyncio.shield(self._flush)

    async def _write(self) -> None:
        while self._waiting:
            rows, self._waiting = self._waiting, {}
            try:
                await self.run(lambda db, rows=rows: _put(db, rows))  # type: ignore[misc]  # mypy: default of a lambda
            except BaseException:
                self._waiting = rows | self._waiting  # for the next try, unless it has changed again
                raise

    async def missing(self) -> list[str]:
        """A sentence, if the database does not do its work."""
        if self._check is None or self._check.done():  # one look at a time, however often it is asked for
            self._check = asyncio.ensure_future(self.run(lambda db: db.execute(sa.select(1)).scalar()))
        try:
            await asyncio.wait_for(asyncio.shield(self._check), PATIENCE)
        except (TimeoutError, sa.exc.SQLAlchemyError) as error:
            log.warn("the database does not answer: {error}", error=str(error) or f"for {PATIENCE:g} s")
            return ["the database does not answer: what changes is not stored"]
        return []

    async def close(self) -> None:
        if self._flush is not None:
            await self._flush
        await self._do(self._engine.dispose)
        self._thread.shutdown()


def _put(connection: sa.Connection, rows: dict[tuple[str, str], str | None]) -> None:
    keys = [{"k": kind, "n": key} for kind, key in rows]
    connection.execute(
        records.delete().where(records.c.kind == sa.bindparam("k"), records.c.key == sa.bindparam("n")), keys
    )
    fresh = [{"kind": kind, "key": key, "value": value} for (kind, key), value in rows.items() if value is not None]
    if fresh:
        connection.execute(records.insert(), fresh)


def _make_private(file: Path) -> None:
    """It has hashes of passwords, and its directory may be open to others. SQLite's other files get the same mode."""
    with contextlib.suppress(OSError):  # that it cannot be made is told when it is opened
        file.touch(mode=0o600)
        if file.stat().st_uid == os.geteuid():
            file.chmod(0o600)


def _tune_sqlite(connection: Any, _: object) -> None:
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=NORMAL")  # survives the death of the process; a power cut costs the last ms
    connection.execute("PRAGMA foreign_keys=ON")
