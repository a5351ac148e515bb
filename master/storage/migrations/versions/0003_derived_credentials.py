"""Credentials name the API key with which they were made."""

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
