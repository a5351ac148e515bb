"""A database of an earlier version gets what this one adds: tables, and columns that may be empty.

More is never needed: what the graph holds is JSON, in which fields have defaults. A change that this cannot make must
bring its own step.
"""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.schema import CreateColumn

from rce.errors import InvalidRequest


def bring_up_to_date(engine: sa.Engine, tables: sa.MetaData) -> list[str]:
    """What was added, as `table.column`. InvalidRequest if the database is too different."""
    tables.create_all(engine)
    added = []
    with engine.begin() as connection:
        inspector = sa.inspect(connection)
        for table in tables.sorted_tables:
            present = {column["name"] for column in inspector.get_columns(table.name)}
            for column in table.columns:
                if column.name not in present:
                    _add(connection, table, column)
                    added.append(f"{table.name}.{column.name}")
    return added


def _add(connection: sa.Connection, table: sa.Table, column: sa.Column[object]) -> None:
    if not column.nullable and column.server_default is None:
        raise InvalidRequest(
            f"the database has no column {table.name}.{column.name}, and what is there has no value for it: it is of "
            "another line of versions",
            field="database",
        )
    name = connection.dialect.identifier_preparer.format_table(table)
    wanted = CreateColumn(column).compile(dialect=connection.dialect)
    connection.execute(sa.text(f"ALTER TABLE {name} ADD COLUMN {wanted}"))
