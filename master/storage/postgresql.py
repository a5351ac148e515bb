"""Connections to PostgreSQL that end soon if the other side is gone.

A lock of a Master that was stopped or cut off must not outlast its lease.
"""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa

IDLE = 4000  # milliseconds that a transaction may be idle: its Master was stopped or cut off
READ_ONLY = "25006"  # SQLSTATE of a write at a server that is no primary any more


def connect(url: sa.URL, timeout: int) -> sa.Engine:
    """Return an engine for a database.

    Args:
        url: URL of the database; what it says of timeouts is kept.
        timeout: Seconds for a connection, and until data that is not acknowledged ends one.
    """
    own = {"connect_timeout": timeout, "tcp_user_timeout": timeout * 1000}
    engine = sa.create_engine(url, connect_args={key: value for key, value in own.items() if key not in url.query})
    sa.event.listen(engine, "connect", lambda connection, _: _tune(connection, timeout))
    return engine


def _tune(connection: Any, timeout: int) -> None:
    """Let the server end transactions and connections whose Master is gone."""
    connection.execute(f"SET idle_in_transaction_session_timeout = {IDLE}")
    connection.execute(f"SET tcp_user_timeout = {timeout * 1000}")
    connection.commit()


def is_lost(error: BaseException) -> bool:
    """Return whether a connection was lost, cannot be made, or leads to a server that is no primary any more."""
    if not isinstance(error, sa.exc.DBAPIError):
        return False
    state = getattr(error.orig, "sqlstate", None)
    return error.connection_invalidated or state == READ_ONLY or (state is None and _is_operational(error))


def _is_operational(error: sa.exc.DBAPIError) -> bool:
    return isinstance(error, sa.exc.OperationalError) and type(error.orig).__module__.startswith("psycopg")
