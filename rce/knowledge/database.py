"""The database of the repository: SQLite, in a thread of its own, one transaction after another."""

from __future__ import annotations

import asyncio
import math
import sqlite3
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

from rce.errors import DiskFull, RceError, Unavailable

EARTH_RADIUS = 6_371_009.0  # metres
VERSION = 1
SCHEMA = """
CREATE TABLE entries (
    id INTEGER PRIMARY KEY, kind TEXT NOT NULL, uid TEXT NOT NULL, cls TEXT NOT NULL, author TEXT NOT NULL,
    description TEXT NOT NULL, version INTEGER NOT NULL, created REAL NOT NULL, modified REAL NOT NULL,
    modified_by TEXT NOT NULL, rating REAL NOT NULL, public INTEGER NOT NULL, latitude REAL, longitude REAL,
    stamp INTEGER NOT NULL, UNIQUE (kind, uid));
CREATE INDEX entries_author ON entries (author);
CREATE INDEX entries_cls ON entries (cls);
CREATE INDEX entries_place ON entries (latitude, longitude);
CREATE TABLE readers (
    entry INTEGER NOT NULL REFERENCES entries ON DELETE CASCADE, user TEXT NOT NULL, PRIMARY KEY (entry, user)
    ) WITHOUT ROWID;
CREATE TABLE versions (
    entry INTEGER NOT NULL REFERENCES entries ON DELETE CASCADE, number INTEGER NOT NULL, time REAL NOT NULL,
    author TEXT NOT NULL, description TEXT NOT NULL, sha256 TEXT NOT NULL, size INTEGER NOT NULL,
    PRIMARY KEY (entry, number));
CREATE TABLE files (
    entry INTEGER NOT NULL, version INTEGER NOT NULL, name TEXT NOT NULL, sha256 TEXT NOT NULL, size INTEGER NOT NULL,
    PRIMARY KEY (entry, version, name),
    FOREIGN KEY (entry, version) REFERENCES versions (entry, number) ON DELETE CASCADE);
CREATE INDEX files_sha256 ON files (sha256);
CREATE INDEX versions_sha256 ON versions (sha256);
CREATE TABLE texts (sha256 TEXT PRIMARY KEY, text TEXT NOT NULL);
CREATE TABLE graphs (entry INTEGER PRIMARY KEY REFERENCES entries ON DELETE CASCADE, triples BLOB NOT NULL);
CREATE TABLE types (
    entry INTEGER NOT NULL REFERENCES entries ON DELETE CASCADE, iri TEXT NOT NULL, local TEXT NOT NULL,
    PRIMARY KEY (entry, iri)) WITHOUT ROWID;
CREATE INDEX types_iri ON types (iri);
CREATE INDEX types_local ON types (local);
CREATE TABLE subclasses (
    entry INTEGER NOT NULL REFERENCES entries ON DELETE CASCADE, low TEXT NOT NULL, high TEXT NOT NULL,
    high_local TEXT NOT NULL, PRIMARY KEY (entry, low, high)) WITHOUT ROWID;
CREATE INDEX subclasses_high ON subclasses (high, low);
CREATE INDEX subclasses_low ON subclasses (low);
CREATE INDEX subclasses_local ON subclasses (high_local);
CREATE VIRTUAL TABLE words USING fts5 (content);
CREATE TABLE changes (
    number INTEGER PRIMARY KEY AUTOINCREMENT, time REAL NOT NULL, action TEXT NOT NULL, kind TEXT NOT NULL,
    uid TEXT NOT NULL, version INTEGER NOT NULL, user TEXT NOT NULL, author TEXT NOT NULL, public INTEGER NOT NULL,
    readers TEXT NOT NULL, types TEXT NOT NULL);
"""

T = TypeVar("T")


class Database:
    """The database. Work is a function of the connection; it runs as one transaction."""

    def __init__(self, file: Path) -> None:
        """Open the file, and create it if it is missing.

        Raises:
            Unavailable: A newer version of RCE has written it.
        """
        self._thread = ThreadPoolExecutor(1, "knowledge-database")
        self._connection = self._thread.submit(_open, file).result()

    async def run(self, work: Callable[[sqlite3.Connection], T]) -> T:
        """Do work in a transaction and return its result.

        Raises:
            DiskFull: There is no room on the disk.
            RceError: As `work`, whose changes are undone.
        """
        return await asyncio.get_running_loop().run_in_executor(self._thread, self._transaction, work)

    def _transaction(self, work: Callable[[sqlite3.Connection], T]) -> T:
        try:
            with self._connection:
                return work(self._connection)
        except RceError:
            raise
        except sqlite3.OperationalError as error:
            if "full" in str(error):
                raise DiskFull.at(f"knowledge service: {error}") from None
            raise

    def close(self) -> None:
        """Close the file, after the work that waits."""
        self._thread.submit(self._connection.close).result()
        self._thread.shutdown()


def _open(file: Path) -> sqlite3.Connection:
    connection = sqlite3.connect(file)
    connection.row_factory = sqlite3.Row
    connection.create_function("distance", 4, distance, deterministic=True)
    connection.executescript("PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; PRAGMA foreign_keys=ON;")
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if version > VERSION:
        raise Unavailable(f"{file} is of a newer version of RCE: it has the format {version}, known is {VERSION}")
    if version == 0:
        connection.executescript(f"BEGIN; {SCHEMA} PRAGMA user_version={VERSION}; COMMIT;")
    return connection


def distance(latitude: float, longitude: float, other_latitude: float, other_longitude: float) -> float:
    """Return the distance in metres of two places in degrees, on a sphere (haversine formula)."""
    a, b = math.radians(latitude), math.radians(other_latitude)
    across = math.sin(math.radians(other_longitude - longitude) / 2) ** 2
    square = math.sin((b - a) / 2) ** 2 + math.cos(a) * math.cos(b) * across
    return 2 * EARTH_RADIUS * math.asin(min(1.0, math.sqrt(square)))
