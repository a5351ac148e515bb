"""Tables of version 0.1.

Databases from before Alembic have these tables already, the oldest with fewer columns and shorter text: they get what
they lack.
"""

from __future__ import annotations

import math

import sqlalchemy as sa
from alembic import op
from sqlalchemy.schema import CreateColumn

from rce.errors import InvalidRequest

revision = "0001"
down_revision = None

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
    sa.Column("scopes", sa.Text),  # JSON; null: not narrowed
)
# Limits of users who do not have those of the platform; the running Master stores the platform's at user "".
limits = sa.Table(
    "limits",
    tables,
    sa.Column("user", sa.String(255), primary_key=True),
    sa.Column("value", sa.Text, nullable=False),
)
# Rights of services to act for users; removed with the user, or with the API key with which they were given.
grants = sa.Table(
    "grants",
    tables,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("service", sa.String(600), nullable=False),
    sa.Column("user", sa.String(255), sa.ForeignKey("users.name", ondelete="CASCADE"), index=True, nullable=False),
    sa.Column(
        "key", sa.String(32), sa.ForeignKey("api_keys.id", ondelete="CASCADE"), index=True
    ),  # null: given with a password
    sa.Column("created", sa.Float, nullable=False),
    sa.Column("lent", sa.String(64), unique=True),  # SHA-256 of the temporary key of the service
    sa.Column("expires", sa.Float),  # of the temporary key
)
# Credentials that processes got for their join tokens.
credentials = sa.Table(
    "credentials",
    tables,
    sa.Column("process", sa.String(600), primary_key=True),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("digest", sa.String(64), nullable=False),
)
# One-time join tokens; used ones stay, so that they cannot be added again.
tokens = sa.Table(
    "tokens",
    tables,
    sa.Column("digest", sa.String(64), primary_key=True),
    sa.Column("process", sa.String(600), nullable=False),
    sa.Column("role", sa.String(16), nullable=False),
    sa.Column("used", sa.Boolean, nullable=False),
)
# Rows are added, and removed when they are too old; none is changed.
audit = sa.Table(
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


def upgrade() -> None:
    """Create the tables, or add the columns that a database from before Alembic lacks."""
    connection = op.get_bind()
    tables.create_all(connection)
    inspector = sa.inspect(connection)
    for table in tables.sorted_tables:
        present = {column["name"]: column["type"] for column in inspector.get_columns(table.name)}
        for column in table.columns:
            if column.name not in present:
                _add_column(connection, table, column)
            elif _is_shorter(connection, present[column.name], column):
                type_ = column.type.compile(connection.dialect)
                _alter_table(connection, table, f"ALTER COLUMN {column.name} TYPE {type_}")


def _is_shorter(connection: sa.Connection, present: object, column: sa.Column[object]) -> bool:
    """Return whether a column holds shorter text than it must. SQLite does not bound text."""
    return (
        connection.dialect.name != "sqlite"
        and isinstance(column.type, sa.String)
        and isinstance(present, sa.String)
        and (present.length or math.inf) < (column.type.length or math.inf)
    )


def _add_column(connection: sa.Connection, table: sa.Table, column: sa.Column[object]) -> None:
    if not column.nullable and column.server_default is None:
        raise InvalidRequest(
            f"the database has no column {table.name}.{column.name}, and its rows have no value for it: it is not a "
            "database of RCE",
            field="database",
        )
    _alter_table(connection, table, f"ADD COLUMN {CreateColumn(column).compile(dialect=connection.dialect)}")


def _alter_table(connection: sa.Connection, table: sa.Table, change: str) -> None:
    name = connection.dialect.identifier_preparer.format_table(table)
    connection.execute(sa.text(f"ALTER TABLE {name} {change}"))
