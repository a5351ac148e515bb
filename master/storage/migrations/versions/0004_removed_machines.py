"""Removals of machines are kept, and with a used invitation the key that got the certificate."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"


def upgrade() -> None:
    """Add what the database lacks."""
    inspector = sa.inspect(op.get_bind())
    if "public_key" not in {each["name"] for each in inspector.get_columns("tokens")}:
        op.add_column("tokens", sa.Column("public_key", sa.String(64)))
    if not inspector.has_table("removed_machines"):
        op.create_table(
            "removed_machines",
            sa.Column("name", sa.String(600), primary_key=True),
            sa.Column("time", sa.Float, nullable=False),
        )
