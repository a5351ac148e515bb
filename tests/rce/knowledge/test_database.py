"""The database of the repository."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from rce.errors import DiskFull, NotFound, Unavailable
from rce.knowledge.database import Database, distance


async def test_failed_work_leaves_no_trace(tmp_path: Path) -> None:
    database = Database(tmp_path / "a.db")

    def fail(connection: sqlite3.Connection) -> None:
        connection.execute("INSERT INTO texts VALUES ('a', 'b')")
        raise NotFound("gone")

    with pytest.raises(NotFound):
        await database.run(fail)
    assert await database.run(lambda connection: connection.execute("SELECT COUNT(*) FROM texts").fetchone()[0]) == 0
    database.close()


async def test_full_disk_is_recognized(tmp_path: Path) -> None:
    database = Database(tmp_path / "a.db")

    def fail(connection: sqlite3.Connection) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    with pytest.raises(DiskFull):
        await database.run(fail)
    database.close()


async def test_file_of_a_newer_version_is_left_alone(tmp_path: Path) -> None:
    Database(tmp_path / "a.db").close()
    with sqlite3.connect(tmp_path / "a.db") as connection:
        connection.execute("PRAGMA user_version = 99")
    with pytest.raises(Unavailable, match="newer version"):
        Database(tmp_path / "a.db")


def test_distance_of_two_places() -> None:
    """Zurich to Munich is 242 km; a degree of latitude is 111.2 km."""
    assert distance(47.3769, 8.5417, 48.1351, 11.5820) == pytest.approx(242_000, rel=0.01)
    assert distance(0, 179.5, 0, -179.5) == pytest.approx(111_195, rel=0.001)
    assert distance(10, 20, 10, 20) == 0
