"""Reading of entries from the database, within the rights of the reader."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from sqlite3 import Connection, Row

from msgspec import Struct

from rce.api.knowledge import Entry, Kind, Location, StoredFile, Version
from rce.errors import Forbidden, NotFound

READABLE = """(:everything OR e.public OR e.author = :user
    OR EXISTS (SELECT 1 FROM readers r WHERE r.entry = e.id AND r.user = :user))"""
"""Condition of SQL on the entry `e`, with the parameters of `Reader.parameters`."""


class Reader(Struct, frozen=True):
    """Reader of entries: a user, or a client without credentials (an empty name); with `everything` it reads all."""

    user: str
    everything: bool = False

    @property
    def parameters(self) -> dict[str, object]:
        """The parameters of READABLE."""
        return {"user": self.user, "everything": self.everything}


def find(connection: Connection, reader: Reader, kind: Kind, uid: str) -> Row:
    """Return the row of an entry.

    Raises:
        NotFound: The reader may not read it, or it does not exist.
    """
    query = f"SELECT * FROM entries e WHERE kind = :kind AND uid = :uid AND {READABLE}"
    row: Row | None = connection.execute(query, {"kind": kind, "uid": uid, **reader.parameters}).fetchone()
    if row is None:
        raise NotFound(f"there is no {kind} {uid[:120]!r}", field="uid")
    return row


def find_own(connection: Connection, reader: Reader, kind: Kind, uid: str) -> Row:
    """Return the row of an entry that the reader may change.

    Raises:
        NotFound: The reader may not read it, or it does not exist.
        Forbidden: It is somebody else's.
    """
    row = find(connection, reader, kind, uid)
    if row["author"] != reader.user and not reader.everything:
        raise Forbidden(f"only {row['author']}, its author, may change the {kind} {uid}")
    return row


def find_version(connection: Connection, row: Row, number: int | None) -> Row:
    """Return the row of a version, of the newest one if `number` is None.

    Raises:
        NotFound: The entry does not have it.
    """
    query = "SELECT * FROM versions WHERE entry = ? AND number = ?"
    found: Row | None = connection.execute(query, (row["id"], row["version"] if number is None else number)).fetchone()
    if found is None:
        raise NotFound(f"the {row['kind']} {row['uid']} has no version {number}", field="version")
    return found


def files_of(connection: Connection, entry: int, version: int) -> list[StoredFile]:
    """Return the files of a version, by name."""
    query = "SELECT name, size, sha256 FROM files WHERE entry = ? AND version = ? ORDER BY name"
    return [StoredFile(*found) for found in connection.execute(query, (entry, version))]


def text_of(connection: Connection, version: Row) -> str:
    """Return the OWL text of a version."""
    found = connection.execute("SELECT text FROM texts WHERE sha256 = ?", (version["sha256"],)).fetchone()
    return str(found[0])


def versions_of(connection: Connection, row: Row) -> list[Version]:
    """Return the versions of an entry, the newest first."""
    found = connection.execute("SELECT * FROM versions WHERE entry = ? ORDER BY number DESC", (row["id"],)).fetchall()
    files: dict[int, list[StoredFile]] = defaultdict(list)
    query = "SELECT version, name, size, sha256 FROM files WHERE entry = ? ORDER BY name"
    for number, *file in connection.execute(query, (row["id"],)):
        files[number].append(StoredFile(*file))
    return [
        Version(each["number"], each["time"], each["author"], each["description"], each["size"], files[each["number"]])
        for each in found
    ]


def entry_of(connection: Connection, reader: Reader, row: Row) -> Entry:
    """Return an entry."""
    return entries_of(connection, reader, [row])[0]


def entries_of(connection: Connection, reader: Reader, rows: Sequence[Row]) -> list[Entry]:
    """Return entries in the order of their rows."""
    ids = ",".join(str(row["id"]) for row in rows)
    readers: dict[int, list[str]] = defaultdict(list)
    for entry, user in connection.execute(f"SELECT entry, user FROM readers WHERE entry IN ({ids}) ORDER BY user"):
        readers[entry].append(user)
    files: dict[int, list[StoredFile]] = defaultdict(list)
    query = f"""SELECT f.entry, f.name, f.size, f.sha256 FROM entries e
        JOIN files f ON f.entry = e.id AND f.version = e.version WHERE e.id IN ({ids}) ORDER BY f.name"""
    for entry, *file in connection.execute(query):
        files[entry].append(StoredFile(*file))
    return [_entry(row, reader, readers[row["id"]], files[row["id"]]) for row in rows]


def _entry(row: Row, reader: Reader, readers: list[str], files: list[StoredFile]) -> Entry:
    owns = row["author"] == reader.user or reader.everything
    return Entry(
        kind=row["kind"],
        uid=row["uid"],
        description=row["description"],
        author=row["author"],
        version=row["version"],
        created=row["created"],
        modified=row["modified"],
        modified_by=row["modified_by"],
        rating=row["rating"],
        public=bool(row["public"]),
        shared=readers if owns else [],
        location=None if row["latitude"] is None else Location(row["latitude"], row["longitude"]),
        files=files,
    )
