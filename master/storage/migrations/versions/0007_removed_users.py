"""Removals of users are kept, so that processes that were away carry them out later."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Add what the database lacks."""
    if not sa.inspect(op.get_bind()).has_table("removed_users"):
        op.create_table(
            "removed_users",
            sa.Column("name", sa.String(64), primary_key=True),
            sa.Column("time", sa.Float, nullable=False),
        )
