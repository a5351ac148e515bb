"""Databases of tests. Their tables are created from a dump: the migrations take longer than most tests."""

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
    await store.prepare(_create_tables)
    await store.open()
    return store


def _create_tables(connection: sa.Connection) -> None:
    """Create what the migrations create, if the database is empty."""
    if sa.inspect(connection).get_table_names():
        return
    for statement in _statements():
        connection.exec_driver_sql(statement)


@cache
def _statements() -> list[str]:
    """Return the dump of an SQLite database that the migrations have created."""
    engine = sa.create_engine(MEMORY)
    upgrade(engine)
    with engine.connect() as connection:
        migrated = connection.connection.driver_connection
        assert isinstance(migrated, sqlite3.Connection)
        statements = [each for each in migrated.iterdump() if not each.startswith(("BEGIN", "COMMIT"))]
    engine.dispose()
    return statements
