"""Writing of entries to the database: each change of text, description or files is a new version."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Sequence
from sqlite3 import Connection, IntegrityError, Row

from msgspec import Struct

from rce.api.knowledge import Action, Kind, Location, StoredFile, Usage
from rce.errors import AlreadyExists, InvalidRequest, LimitExceeded
from rce.knowledge.messages import Reading
from rce.knowledge.names import local_name
from rce.knowledge.records import READABLE, files_of, find_version, text_of
from rce.spelling import with_article

VERSION_COST = 1024  # bytes of the quota for what a version has beside its contents
KEPT_CHANGES = 100_000
NEW_RATING = 1.0
MAX_FILES = 100  # of a version
MAX_NOTED = 1000  # classes that are noted with a change
CONTENTS = """SELECT v.entry, v.sha256, v.size FROM versions v JOIN entries e ON e.id = v.entry WHERE e.author = :user
    UNION SELECT f.entry, f.sha256, f.size FROM files f JOIN entries e ON e.id = f.entry WHERE e.author = :user"""


CLASSES = f"""WITH RECURSIVE above (iri) AS (
        SELECT iri FROM types WHERE entry = :entry
        UNION SELECT s.high FROM subclasses s JOIN above ON s.low = above.iri
            JOIN entries e ON e.id = s.entry WHERE {READABLE})
    SELECT iri FROM above LIMIT {MAX_NOTED}"""
"""The classes of an entry and those above them, by what the entries say that its author may read."""


class Draft(Struct, frozen=True):
    """Version to write."""

    author: str
    description: str
    text: str
    files: Sequence[StoredFile] = ()
    time: float = 0.0


class Header(Struct, frozen=True):
    """Fields of an entry beside its versions. `cls` is the first part of the uid."""

    kind: Kind
    uid: str
    author: str
    public: bool = False
    readers: Sequence[str] = ()
    location: Location | None = None
    rating: float = NEW_RATING
    created: float = 0.0


def insert(connection: Connection, header: Header) -> Row:
    """Add an entry, which needs a version; return its row.

    Raises:
        AlreadyExists: There is an entry of this uid.
    """
    values = {
        "kind": header.kind,
        "uid": header.uid,
        "cls": header.uid.partition(".")[0],
        "author": header.author,
        "public": header.public,
        "rating": header.rating,
        "created": header.created or time.time(),
    }
    names = ", ".join(values)
    query = f"""INSERT INTO entries ({names}, description, version, modified, modified_by, stamp)
        VALUES ({", ".join(f":{name}" for name in values)}, '', 0, 0, '', 0)"""
    try:
        entry = connection.execute(query, values).lastrowid
    except IntegrityError:
        raise AlreadyExists(f"there is {with_article(header.kind)} {header.uid} already", field="id") from None
    assert entry is not None
    set_readers(connection, entry, header.readers)
    set_location(connection, entry, header.location)
    return _row(connection, entry)


def set_readers(connection: Connection, entry: int, users: Iterable[str]) -> None:
    """Set the users who may read an entry."""
    connection.execute("DELETE FROM readers WHERE entry = ?", (entry,))
    connection.executemany("INSERT INTO readers VALUES (?, ?)", [(entry, user) for user in sorted(set(users))])


def set_location(connection: Connection, entry: int, location: Location | None) -> None:
    """Set or remove the location of an entry."""
    place = (None, None) if location is None else (location.latitude, location.longitude)
    connection.execute("UPDATE entries SET latitude = ?, longitude = ? WHERE id = ?", (*place, entry))


def set_public(connection: Connection, entry: int, public: bool) -> None:
    """Set whether all users may read an entry."""
    connection.execute("UPDATE entries SET public = ? WHERE id = ?", (public, entry))


def add_version(connection: Connection, row: Row, draft: Draft) -> Row:
    """Add a version; return the new row of the entry. `index` must follow if its text or description has changed.

    Raises:
        LimitExceeded: There are too many files.
    """
    if len(draft.files) > MAX_FILES:
        raise LimitExceeded(f"an entry may have {MAX_FILES} files", limit=MAX_FILES)
    entry, number, now = row["id"], row["version"] + 1, draft.time or time.time()
    data = draft.text.encode()
    digest = hashlib.sha256(data).hexdigest()
    connection.execute("INSERT OR IGNORE INTO texts VALUES (?, ?)", (digest, draft.text))
    values = (entry, number, now, draft.author, draft.description, digest, len(data))
    connection.execute("INSERT INTO versions VALUES (?, ?, ?, ?, ?, ?, ?)", values)
    files = [(entry, number, file.name, file.sha256, file.size) for file in draft.files]
    connection.executemany("INSERT INTO files VALUES (?, ?, ?, ?, ?)", files)
    query = "UPDATE entries SET version = ?, description = ?, modified = ?, modified_by = ? WHERE id = ?"
    connection.execute(query, (number, draft.description, now, draft.author, entry))
    return _row(connection, entry)


def newest(connection: Connection, row: Row) -> Draft:
    """Return the newest version of an entry as a draft."""
    version = find_version(connection, row, None)
    files = files_of(connection, row["id"], row["version"])
    return Draft(version["author"], version["description"], text_of(connection, version), files)


def index(connection: Connection, row: Row, reading: Reading) -> None:
    """Make the newest version of an entry known to searches and queries."""
    entry = row["id"]
    connection.execute("INSERT OR REPLACE INTO graphs VALUES (?, ?)", (entry, reading.triples))
    for table in ("types", "subclasses"):
        connection.execute(f"DELETE FROM {table} WHERE entry = ?", (entry,))
    types = [(entry, iri, local_name(iri)) for iri in reading.types]
    connection.executemany("INSERT INTO types VALUES (?, ?, ?)", types)
    pairs = [(entry, low, high, local_name(high)) for low, high in reading.subclasses]
    connection.executemany("INSERT INTO subclasses VALUES (?, ?, ?, ?)", pairs)
    connection.execute("DELETE FROM words WHERE rowid = ?", (entry,))
    words = f"{row['uid'].replace('.', ' ')} {row['description']} {reading.words}"
    connection.execute("INSERT INTO words (rowid, content) VALUES (?, ?)", (entry, words))
    stamp = connection.execute("SELECT COALESCE(MAX(seq), 0) + 1 FROM sqlite_sequence").fetchone()[0]
    connection.execute("UPDATE entries SET stamp = ? WHERE id = ?", (stamp, entry))


def note(connection: Connection, row: Row, action: Action, user: str) -> None:
    """Note a change for subscribers, with who may know of it."""
    entry = row["id"]
    readers = [found[0] for found in connection.execute("SELECT user FROM readers WHERE entry = ?", (entry,))]
    known = {"entry": entry, "user": row["author"], "everything": False}
    types = [found[0] for found in connection.execute(CLASSES, known)]
    values = (time.time(), action, row["kind"], row["uid"], row["version"], user, row["author"], row["public"])
    query = f"""INSERT INTO changes (time, action, kind, uid, version, user, author, public, readers, types)
        VALUES ({", ".join("?" * 10)})"""
    number = connection.execute(query, (*values, json.dumps(readers), json.dumps(types))).lastrowid
    assert number is not None
    connection.execute("DELETE FROM changes WHERE number <= ?", (number - KEPT_CHANGES,))


def remove(connection: Connection, row: Row) -> list[str]:
    """Remove an entry; return the digests of files that nothing refers to any more."""
    digests = _digests(connection, "entry = ?", (row["id"],))
    connection.execute("DELETE FROM words WHERE rowid = ?", (row["id"],))
    connection.execute("DELETE FROM entries WHERE id = ?", (row["id"],))
    return _forget(connection, digests)


def forget_user(connection: Connection, user: str) -> list[str]:
    """Remove a user's entries and right to read others; return the digests of files that nothing refers to any more.

    What is noted of changes must not be shown to a later user of the same name.
    """
    unused: list[str] = []
    for row in connection.execute("SELECT * FROM entries WHERE author = ?", (user,)).fetchall():
        note(connection, row, "removed", user)
        unused += remove(connection, row)
    connection.execute("DELETE FROM readers WHERE user = ?", (user,))
    connection.execute("UPDATE changes SET author = '' WHERE author = ?", (user,))
    noted = connection.execute("SELECT number, readers FROM changes WHERE readers LIKE ?", (f'%"{user}"%',)).fetchall()
    for number, readers in noted:
        others = [each for each in json.loads(readers) if each != user]
        connection.execute("UPDATE changes SET readers = ? WHERE number = ?", (json.dumps(others), number))
    return unused


def remove_version(connection: Connection, row: Row, number: int) -> list[str]:
    """Remove an old version; return the digests of files that nothing refers to any more.

    Raises:
        InvalidRequest: It is the newest version.
        NotFound: The entry does not have it.
    """
    find_version(connection, row, number)
    if number == row["version"]:
        raise InvalidRequest(
            "the newest version cannot be removed; remove the entry, or add a version", field="version"
        )
    where, values = "entry = ? AND {} = ?", (row["id"], number)
    digests = _digests(connection, where, values)
    connection.execute(f"DELETE FROM versions WHERE {where.format('number')}", values)
    return _forget(connection, digests)


def usage(connection: Connection, user: str, limit: int) -> Usage:
    """Return what a user's entries take of the quota."""
    size = connection.execute(f"SELECT COALESCE(SUM(size), 0) FROM ({CONTENTS})", {"user": user}).fetchone()[0]
    query = """SELECT COUNT(DISTINCT e.id), COUNT(*) FROM entries e JOIN versions v ON v.entry = e.id
        WHERE e.author = ?"""
    entries, versions = connection.execute(query, (user,)).fetchone()
    return Usage(entries, size + versions * VERSION_COST, limit)


def check_quota(connection: Connection, user: str, limit: int) -> None:
    """Check what a user has after a change, which is undone by the error.

    Raises:
        LimitExceeded: It is more than the quota.
    """
    used = usage(connection, user, limit).bytes
    if used > limit:
        text = f"with this, entries of {user} would have {used} bytes; the quota is {limit}: remove entries or versions"
        raise LimitExceeded(text, limit=limit, actual=used)


def known_digests(connection: Connection) -> set[str]:
    """Return the digests of all files."""
    return {row[0] for row in connection.execute("SELECT DISTINCT sha256 FROM files")}


def _digests(connection: Connection, where: str, values: tuple[int, ...]) -> set[str]:
    found: set[str] = set()
    for table, number in (("versions", "number"), ("files", "version")):
        query = f"SELECT sha256 FROM {table} WHERE {where.format(number)}"
        found.update(row[0] for row in connection.execute(query, values))
    return found


def _forget(connection: Connection, digests: set[str]) -> list[str]:
    """Remove the texts among these that nothing refers to, and return the files."""
    unused = []
    for digest in digests:
        if not connection.execute("SELECT 1 FROM versions WHERE sha256 = ? LIMIT 1", (digest,)).fetchone():
            connection.execute("DELETE FROM texts WHERE sha256 = ?", (digest,))
        if not connection.execute("SELECT 1 FROM files WHERE sha256 = ? LIMIT 1", (digest,)).fetchone():
            unused.append(digest)
    return unused


def _row(connection: Connection, entry: int) -> Row:
    row: Row = connection.execute("SELECT * FROM entries WHERE id = ?", (entry,)).fetchone()
    return row
