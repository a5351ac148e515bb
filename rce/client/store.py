"""Store of a publisher: messages that the platform does not have yet, in memory or in a file."""

from __future__ import annotations

import sqlite3
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from typing import NamedTuple

import msgspec

from rce.errors import AlreadyExists, DiskFull, InvalidRequest
from rce.protocol.blobs import Buffer

MAX_BYTES = 64 << 20
OVERHEAD = 100  # bytes of a message beside its content
VERSION = 1
_TABLES = """
CREATE TABLE state (type TEXT NOT NULL, stream TEXT NOT NULL, incarnation TEXT NOT NULL, sent INTEGER NOT NULL);
CREATE TABLE messages (
    number INTEGER PRIMARY KEY AUTOINCREMENT, made REAL NOT NULL, bytes INTEGER NOT NULL, body BLOB NOT NULL, blobs BLOB
);
"""


@dataclass(frozen=True, slots=True)
class Store:
    """Place for the messages of a publisher until the platform has them.

    Attributes:
        path: File that keeps them when the program ends, for one publisher; None for memory.
        max_bytes: Size of all messages, above which the oldest are dropped. The newest one is always kept.
    """

    path: str | PathLike[str] | None = None
    max_bytes: int = MAX_BYTES


class Stored(NamedTuple):
    """A message in a store; `made` is its time in seconds since 1970, `body` the JSON object with its `msg`."""

    number: int
    made: float
    body: bytes
    blobs: Mapping[str, Buffer]


class MessageStore:
    """Messages of one stream in their order, each with a number that rises.

    Attributes:
        stream: Name of the stream, unique.
        incarnation: Incarnation of the Robot endpoint to which messages were written last; empty for none.
        sent: Number of the last message that was written to it.
    """

    def __init__(self, store: Store, type_name: str) -> None:
        """Open the store.

        Args:
            store: Where it is, and its size.
            type_name: ROS type of its messages.

        Raises:
            AlreadyExists: Another publisher uses the file.
            InvalidRequest: The file is no store of messages of this type.
            DiskFull: The disk is full.
        """
        self._path = str(store.path) if store.path is not None else ":memory:"
        self._max_bytes = store.max_bytes
        with self._errors():
            self._db = sqlite3.connect(self._path, timeout=0, isolation_level=None)
            self._db.execute("PRAGMA locking_mode = EXCLUSIVE")
            self._db.execute("PRAGMA journal_mode = WAL")
            self._db.execute("PRAGMA synchronous = NORMAL")  # a message costs no fsync; a power cut may cost the last
            self._prepare(type_name)
            ((self.stream, self.incarnation, self.sent),) = self._db.execute(
                "SELECT stream, incarnation, sent FROM state"
            )
            ((self._bytes,),) = self._db.execute("SELECT coalesce(sum(bytes), 0) FROM messages")

    def _prepare(self, type_name: str) -> None:
        ((version,),) = self._db.execute("PRAGMA user_version")
        if version == 0 and not self._db.execute("SELECT name FROM sqlite_master").fetchall():
            self._db.executescript(f"BEGIN IMMEDIATE; {_TABLES} PRAGMA user_version = {VERSION}; COMMIT;")
            self._db.execute("INSERT INTO state VALUES (?, ?, '', 0)", (type_name, uuid.uuid4().hex))
        elif version != VERSION:
            raise InvalidRequest(f"{self._path} is a database, but no store of messages: use another file")
        ((stored,),) = self._db.execute("SELECT type FROM state")
        if stored != type_name:
            raise InvalidRequest(f"{self._path} has messages of type {stored}, not {type_name}: use another file")

    def add(self, made: float, body: bytes, blobs: Mapping[str, Buffer]) -> int:
        """Add a message; return its number.

        Raises:
            DiskFull: The disk is full.
        """
        size = len(body) + sum(map(len, blobs.values())) + OVERHEAD
        packed = msgspec.msgpack.encode({name: bytes(blob) for name, blob in blobs.items()}) if blobs else None
        with self._errors():
            row = self._db.execute(
                "INSERT INTO messages (made, bytes, body, blobs) VALUES (?, ?, ?, ?)", (made, size, body, packed)
            )
        self._bytes += size
        assert row.lastrowid is not None
        return row.lastrowid

    def surplus(self) -> Iterator[int]:
        """Remove the oldest messages while all are too large together; yield their numbers."""
        while self._bytes > self._max_bytes:
            numbers = [number for (number,) in self._db.execute("SELECT number FROM messages ORDER BY number LIMIT 2")]
            if len(numbers) < 2:
                return
            self.remove(numbers[0])
            yield numbers[0]

    def after(self, number: int) -> Stored | None:
        """Return the first message behind this number."""
        with self._errors():
            row = self._db.execute(
                "SELECT number, made, body, blobs FROM messages WHERE number > ? ORDER BY number LIMIT 1", (number,)
            ).fetchone()
        if row is None:
            return None
        found, made, body, packed = row
        return Stored(found, made, body, msgspec.msgpack.decode(packed) if packed is not None else {})

    def remove(self, number: int) -> None:
        """Remove a message, if there is one of this number."""
        with self._errors():
            row = self._db.execute("DELETE FROM messages WHERE number = ? RETURNING bytes", (number,)).fetchone()
        if row is not None:
            self._bytes -= row[0]

    def written(self, number: int, incarnation: str) -> None:
        """Remember that a message was written to a Robot endpoint."""
        self.sent, self.incarnation = number, incarnation
        with self._errors():
            self._db.execute("UPDATE state SET sent = ?, incarnation = ?", (number, incarnation))

    def close(self) -> None:
        """Close the file; messages in memory are forgotten."""
        self._db.close()

    @contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            text = str(error)
            if "full" in text:
                raise DiskFull.at(self._path) from None
            if "locked" in text:
                raise AlreadyExists(f"{self._path} is in use by another publisher: give each its own file") from None
            raise InvalidRequest(f"the store {self._path} cannot be used: {text}") from None
