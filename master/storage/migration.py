"""Migration of the database to this version, with the Alembic revisions in `migrations/versions`."""

from __future__ import annotations

from pathlib import Path

import sqlalchemy as sa

from rce.errors import InvalidRequest

HEAD = "0003"  # the newest revision
SCRIPTS = Path(__file__).with_name("migrations")


def upgrade(engine: sa.Engine) -> None:
    """Create the tables, or migrate those of an earlier version.

    Raises:
        InvalidRequest: The database is of a later version, or of none.
    """
    with engine.begin() as connection:
        if _revision(connection) == HEAD:
            return  # Alembic takes a while to import
        _run_alembic(connection)


def _revision(connection: sa.Connection) -> str | None:
    if not sa.inspect(connection).has_table("alembic_version"):
        return None
    revision: str | None = connection.execute(sa.text("SELECT version_num FROM alembic_version")).scalar()
    return revision


def _run_alembic(connection: sa.Connection) -> None:
    from alembic import command
    from alembic.config import Config
    from alembic.util import CommandError

    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    config.attributes["connection"] = connection
    try:
        command.upgrade(config, "head")
    except CommandError as error:
        raise InvalidRequest(
            f"the database cannot be migrated: {error}. It was probably written by a later version of RCE: run that "
            "version, or restore a backup (docs/operations.md)",
            field="database",
        ) from None
