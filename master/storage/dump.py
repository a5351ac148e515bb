"""Contents of the database as text, the same for SQLite and PostgreSQL: a file for each table, a line of JSON a row."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import sqlalchemy as sa

from master.storage import migration
from master.storage import tables as db
from master.storage.tables import tables
from rce.errors import AlreadyExists, InvalidRequest

SUFFIX = ".jsonl"
BATCH = 1000  # rows
LEFT_OUT = {migration.REVISIONS, db.leader.name, db.archives.name}  # packages are files of a backup


def write(connection: sa.Connection, directory: Path) -> str:
    """Write all tables to files in `directory`, as they are at one moment.

    Args:
        connection: Connection whose transaction has not begun to read.
        directory: An empty directory.

    Returns:
        The revision of the database.

    Raises:
        InvalidRequest: It is not a database of a Master.
    """
    if connection.dialect.name == "postgresql":  # in SQLite each transaction reads one snapshot
        connection.exec_driver_sql("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ")
    revision = migration.revision(connection)
    if revision is None:
        raise InvalidRequest(f"{connection.engine.url!r} is not the database of a Master")
    for table in _own_tables(connection):
        # A key is made after the key that made it, which must be there first.
        query = sa.select(table).order_by(table.c.created) if "created" in table.c else sa.select(table)
        with (directory / f"{table.name}{SUFFIX}").open("wb") as file:
            for row in connection.execute(query).mappings():
                file.write(msgspec.json.encode(dict(row)) + b"\n")
    return revision


def read(connection: sa.Connection, directory: Path, revision: str, replace: bool) -> None:
    """Fill the database with the rows that `write` wrote, and migrate it to this version.

    Args:
        connection: Connection whose transaction has not begun.
        directory: The files.
        revision: The revision of the database that was written.
        replace: Remove what the database has, instead of refusing it.

    Raises:
        AlreadyExists: The database has users already.
        InvalidRequest: The files are of a later version of RCE.
    """
    _remove_tables(connection, replace)
    migration.migrate(connection, revision)
    for table in _own_tables(connection):
        for rows in _batches(directory / f"{table.name}{SUFFIX}"):
            connection.execute(table.insert(), rows)
        _continue_numbers(connection, table)
    migration.migrate(connection, migration.HEAD)


def _own_tables(connection: sa.Connection) -> list[sa.Table]:
    """Return the tables as they are in the database, each after those that it refers to."""
    found = sa.MetaData()
    found.reflect(connection)
    return [table for table in found.sorted_tables if table.name not in LEFT_OUT]


def _remove_tables(connection: sa.Connection, replace: bool) -> None:
    """Remove the Master's tables, if there are no users or they are to be replaced."""
    found = sa.MetaData()
    found.reflect(connection, only=lambda name, _: name in {*tables.tables, migration.REVISIONS})
    users = found.tables.get("users")
    if users is not None and not replace and connection.execute(sa.select(users).limit(1)).first():
        raise AlreadyExists(
            f"the database {connection.engine.url!r} has users already: give --replace to lose them, or restore to "
            "another place"
        )
    found.drop_all(connection)


def _batches(file: Path) -> Iterator[list[dict[str, Any]]]:
    with file.open("rb") as lines:
        rows: list[dict[str, Any]] = []
        for line in lines:
            rows.append(msgspec.json.decode(line, type=dict[str, Any]))
            if len(rows) == BATCH:
                yield rows
                rows = []
        if rows:
            yield rows


def _continue_numbers(connection: sa.Connection, table: sa.Table) -> None:
    """Let PostgreSQL number new rows after those that were inserted with their numbers; SQLite does so by itself."""
    if connection.dialect.name != "postgresql" or "id" not in table.c or not isinstance(table.c.id.type, sa.Integer):
        return
    last = sa.select(sa.func.max(table.c.id)).scalar_subquery()
    sequence = sa.func.pg_get_serial_sequence(table.name, "id")
    connection.execute(sa.select(sa.func.setval(sequence, sa.func.coalesce(last, 1))))
