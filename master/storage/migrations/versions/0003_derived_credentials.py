"""Credentials name the API key with which they were made. Machines that were removed are remembered."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"

COLUMNS = (("api_keys", "parent"), ("tokens", "key"))


def upgrade() -> None:
    """Add what the database lacks."""
    inspector = sa.inspect(op.get_bind())
    for table, column in COLUMNS:
        if column not in {each["name"] for each in inspector.get_columns(table)}:
            reference = "VARCHAR(32) REFERENCES api_keys (id) ON DELETE CASCADE"  # SQLite adds no constraint later
            op.execute(f"ALTER TABLE {table} ADD COLUMN {column} {reference}")
            op.create_index(f"ix_{table}_{column}", table, [column])
    if "ix_tokens_process" not in {each["name"] for each in inspector.get_indexes("tokens")}:
        op.create_index("ix_tokens_process", "tokens", ["process"])
    if "removed_machines" not in inspector.get_table_names():
        op.create_table(
            "removed_machines",
            sa.Column("name", sa.String(64), primary_key=True),
            sa.Column("time", sa.Float, nullable=False),
        )
