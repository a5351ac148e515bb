"""A database of an earlier version gets what this one adds: tables, columns that may be empty, room for longer text.

More is never needed: what the graph holds is JSON, in which fields have defaults. A change that this cannot make must
bring its own step.
"""

from __future__ import annotations

import math

import sqlalchemy as sa
from sqlalchemy.schema import CreateColumn

from rce.errors import InvalidRequest


def bring_up_to_date(engine: sa.Engine, tables: sa.MetaData) -> list[str]:
    """What was added or made longer, as `table.column`. InvalidRequest if the database is too different."""
    tables.create_all(engine)
    changed = []
    with engine.begin() as connection:
        inspector = sa.inspect(connection)
        for table in tables.sorted_tables:
            present = {column["name"]: column["type"] for column in inspector.get_columns(table.name)}
            for column in table.columns:
                if column.name not in present:
                    _add(connection, table, column)
                elif _is_too_short(connection, present[column.name], column):
                    _change(
                        connection, table, f"ALTER COLUMN {column.name} TYPE {column.type.compile(connection.dialect)}"
                    )
                else:
                    continue
                changed.append(f"{table.name}.{column.name}")
    return changed


def _is_too_short(connection: sa.Connection, present: object, column: sa.Column[object]) -> bool:
    """SQLite does not care how long text is."""
    return (
        connection.dialect.name != "sqlite"
        and isinstance(column.type, sa.String)
        and isinstance(present, sa.String)
        and (present.length or math.inf) < (column.type.length or math.inf)
    )


def _add(connection: sa.Connection, table: sa.Table, column: sa.Column[object]) -> None:
    if not column.nullable and column.server_default is None:
        raise InvalidRequest(
            f"the database has no column {table.name}.{column.name}, and what is there has no value for it: it is of "
            "another line of versions",
            field="database",
        )
    _change(connection, table, f"ADD COLUMN {CreateColumn(column).compile(dialect=connection.dialect)}")


def _change(connection: sa.Connection, table: sa.Table, what: str) -> None:
    name = connection.dialect.identifier_preparer.format_table(table)
    connection.execute(sa.text(f"ALTER TABLE {name} {what}"))
