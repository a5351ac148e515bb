"""Alembic environment: runs revisions over the connection that `master.storage.migration` opened."""

from __future__ import annotations

from alembic import context

from master.storage.tables import tables

context.configure(connection=context.config.attributes["connection"], target_metadata=tables)
with context.begin_transaction():
    context.run_migrations()
