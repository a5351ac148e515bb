"""A private PostgreSQL."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
import sqlalchemy as sa

from rce.bench.standby import database as database_module
from rce.bench.standby.database import Database, program
from rce.errors import Unavailable
from tests.support.master.postgresql import needs_postgres


@needs_postgres
def test_database_serves_and_stops() -> None:
    with tempfile.TemporaryDirectory() as directory:
        Path(directory).chmod(0o755)
        database = Database(Path(directory) / "postgresql", "127.0.0.77", [], {})
        database.start()
        try:
            engine = sa.create_engine(database.url)
            with engine.connect() as connection:
                assert connection.execute(sa.text("SELECT 1")).scalar() == 1
            engine.dispose()
        finally:
            database.stop()


def test_missing_postgresql_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(database_module, "PLACES", "/nowhere")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(Unavailable, match="apt-get install postgresql"):
        program("initdb")
