"""Migration of the database to this version, with the Alembic revisions in `migrations/versions`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import sqlalchemy as sa

from rce.errors import InvalidRequest

HEAD = "0007"  # the newest revision
REVISIONS = "alembic_version"  # the table that has the revision of the database
SCRIPTS = Path(__file__).with_name("migrations")


def upgrade(engine: sa.Engine, fence: Callable[[sa.Connection], None] | None = None) -> None:
    """Create the tables, or migrate those of an earlier version; `fence` raises an error if this is not permitted.

    Raises:
        InvalidRequest: The database is of a later version, or of none.
    """
    with engine.begin() as connection:
        if fence is not None:
            fence(connection)
        migrate(connection, HEAD)


def revision(connection: sa.Connection) -> str | None:
    """Return the revision of the database; None if it is none of a Master."""
    if not sa.inspect(connection).has_table(REVISIONS):
        return None
    found: str | None = connection.execute(sa.text(f"SELECT version_num FROM {REVISIONS}")).scalar()
    return found


def migrate(connection: sa.Connection, to: str) -> None:
    """Create the tables, or migrate those of an earlier revision.

    Raises:
        InvalidRequest: The database is of a later version, or `to` is.
    """
    if revision(connection) == to:
        return  # Alembic takes a while to import
    from alembic import command
    from alembic.config import Config
    from alembic.util import CommandError

    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    config.attributes["connection"] = connection
    try:
        command.upgrade(config, to)
    except CommandError as error:
        raise InvalidRequest(
            f"the database cannot be migrated: {error}. It was probably written by a later version of RCE: run that "
            "version, or restore a backup (docs/operations.md)",
            field="database",
        ) from None
