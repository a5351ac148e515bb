"""Databases of tests. Their tables are made at once: the migrations take longer than most tests."""

from __future__ import annotations

import sqlite3
from functools import cache

import sqlalchemy as sa

from master.storage.migration import upgrade
from master.storage.store import Store

MEMORY = "sqlite://"


async def open_store(url: str = MEMORY) -> Store:
    """Open an SQLite database. A new one gets the tables of this version."""
    store = Store(url)
    await store.prepare(create_tables)
    await store.open()
    return store


def create_tables(connection: sa.Connection) -> None:
    """Make what the migrations make, if an SQLite database is empty."""
    if sa.inspect(connection).get_table_names():
        return
    for statement in _statements():
        connection.exec_driver_sql(statement)


@cache
def _statements() -> list[str]:
    engine = sa.create_engine(MEMORY)
    upgrade(engine)
    with engine.connect() as connection:
        migrated = connection.connection.driver_connection
        assert isinstance(migrated, sqlite3.Connection)
        statements = [each for each in migrated.iterdump() if not each.startswith(("BEGIN", "COMMIT"))]
    engine.dispose()
    return statements
