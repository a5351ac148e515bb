"""Limits of zero: until then 0 stood for no limit, which is null now."""

from __future__ import annotations

import json

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"

limits = sa.table("limits", sa.column("user", sa.String), sa.column("value", sa.Text))


def upgrade() -> None:
    """Rewrite the limits of users and of the platform."""
    connection = op.get_bind()
    for user, value in connection.execute(sa.select(limits.c.user, limits.c.value)).all():
        changed = {name: None if limit == 0 else limit for name, limit in json.loads(value).items()}
        connection.execute(limits.update().where(limits.c.user == user).values(value=json.dumps(changed)))
