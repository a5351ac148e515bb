"""Several Masters may share a database: which of them leads, and the archives of packages."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Add what the database lacks: the table `leader` is made before all others."""
    inspector = sa.inspect(op.get_bind())
    if not inspector.has_table("leader"):
        op.create_table(
            "leader",
            sa.Column("id", sa.Integer, primary_key=True),
            sa.Column("term", sa.BigInteger, unique=True, nullable=False),
            sa.Column("holder", sa.String(64), nullable=False),
            sa.Column("url", sa.Text, nullable=False),
            sa.Column("until", sa.DateTime(timezone=True), nullable=False),
        )
    if not inspector.has_table("archives"):
        op.create_table(
            "archives",
            sa.Column("digest", sa.String(64), primary_key=True),
            sa.Column("part", sa.Integer, primary_key=True),
            sa.Column("data", sa.LargeBinary, nullable=False),
        )
