"""The repository: what users do with entries, each within their rights and as one transaction."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from sqlite3 import Connection, Row
from typing import TypeVar

from msgspec import UNSET, Struct
from msgspec.structs import replace

from rce.api.knowledge import Change, Entry, EntryChange, EntryPage, Kind, NewEntry, StoredFile, Usage, Version
from rce.control.calls.knowledge import NotedChange
from rce.errors import NotFound
from rce.knowledge import records, writing
from rce.knowledge.changes import Subscription, read_changes, read_noted
from rce.knowledge.contents import Contents
from rce.knowledge.database import Database
from rce.knowledge.names import check_file_name, graph_of, make_uid
from rce.knowledge.records import Reader
from rce.knowledge.search import Search, find_entries
from rce.knowledge.texts import Texts
from rce.process.metrics import Counter

T = TypeVar("T")

_changes = Counter("rce_knowledge_changes", "Changes of the repository, each of which may be of many entries")


class RepositoryLimits(Struct, frozen=True):
    """Limits of the repository in bytes.

    Attributes:
        file: Size of a file.
        user: Quota of a user.
        spare: Room on the disk that stays free.
    """

    file: int = 256 * 1024**2
    user: int = 4 * 1024**3
    spare: int = 1024**3


class OwlText(Struct, frozen=True):
    """OWL text of a version."""

    version: int
    text: str


class Repository:
    """Entries with their versions, files and changes."""

    def __init__(self, directory: Path, limits: RepositoryLimits, texts: Texts) -> None:
        """Open the repository, and create it if it is missing.

        Raises:
            Unavailable: A newer version of RCE has written it.
        """
        directory.mkdir(parents=True, exist_ok=True, mode=0o700)
        self.limits = limits
        self.texts = texts
        self.contents = Contents(directory / "files", limits.file, limits.spare)
        self.database = Database(directory / "knowledge.db")
        self._changed = asyncio.Event()

    async def start(self) -> None:
        """Remove the files of changes that were not completed."""
        await self.database.run(lambda connection: self.contents.sweep(writing.known_digests(connection)))

    # --- reading -----------------------------------------------------------------------------------------------------

    async def entry(self, reader: Reader, kind: Kind, uid: str) -> Entry:
        """Return an entry; raise NotFound."""
        return await self._read(reader, kind, uid, lambda connection, row: records.entry_of(connection, reader, row))

    async def text(self, reader: Reader, kind: Kind, uid: str, version: int | None = None) -> OwlText:
        """Return the OWL text of a version, of the newest one if it is None; raise NotFound."""

        def text(connection: Connection, row: Row) -> OwlText:
            found = records.find_version(connection, row, version)
            return OwlText(found["number"], records.text_of(connection, found))

        return await self._read(reader, kind, uid, text)

    async def versions(self, reader: Reader, kind: Kind, uid: str) -> list[Version]:
        """Return all versions of an entry, the newest first; raise NotFound."""
        return await self._read(reader, kind, uid, records.versions_of)

    async def file(self, reader: Reader, kind: Kind, uid: str, name: str, version: int | None = None) -> Path:
        """Return the path of a file of a version; raise NotFound."""

        def file(connection: Connection, row: Row) -> Path:
            number = records.find_version(connection, row, version)["number"]
            for found in records.files_of(connection, row["id"], number):
                if found.name == name:
                    return self.contents.path(found.sha256)
            raise NotFound(f"the {kind} {uid} has no file {name[:80]!r}", field="file")

        return await self._read(reader, kind, uid, file)

    async def search(self, reader: Reader, wanted: Search) -> EntryPage:
        """Return a page of the entries that fit."""
        return await self.database.run(lambda connection: find_entries(connection, reader, wanted))

    async def usage(self, user: str) -> Usage:
        """Return what a user's entries take of the quota."""
        return await self.database.run(lambda connection: writing.usage(connection, user, self.limits.user))

    async def _read(self, reader: Reader, kind: Kind, uid: str, work: Callable[[Connection, Row], T]) -> T:
        return await self.database.run(lambda connection: work(connection, records.find(connection, reader, kind, uid)))

    # --- graphs ------------------------------------------------------------------------------------------------------

    async def stamps(self, reader: Reader) -> dict[str, int]:
        """Return the named graphs that a reader may read, each with a number that changes with its content."""
        query = f"SELECT kind, uid, stamp FROM entries e WHERE {records.READABLE}"

        def stamps(connection: Connection) -> dict[str, int]:
            return {graph_of(row[0], row[1]): row[2] for row in connection.execute(query, reader.parameters)}

        return await self.database.run(stamps)

    async def triples(self, graphs: Sequence[str]) -> dict[str, bytes]:
        """Return the contents of named graphs as N-Triples; those that are gone are missing."""
        names = {graph: tuple(graph.split("/")[-2:]) for graph in graphs}
        query = "SELECT triples FROM graphs JOIN entries ON id = entry WHERE kind = ? AND uid = ?"

        def triples(connection: Connection) -> dict[str, bytes]:
            found = ((graph, connection.execute(query, name).fetchone()) for graph, name in names.items())
            return {graph: row[0] for graph, row in found if row is not None}

        return await self.database.run(triples)

    # --- changes -----------------------------------------------------------------------------------------------------

    async def add(self, user: str, new: NewEntry) -> Entry:
        """Add an entry.

        Raises:
            AlreadyExists: There is an entry of this uid.
            InvalidRequest: The OWL text is refused.
            LimitExceeded: The quota is used up.
        """
        uid = make_uid(new.cls, new.id)
        reading = await self.texts.read(user, graph_of(new.kind, uid), new.owl)
        header = writing.Header(new.kind, uid, user, new.public, new.shared, new.location)
        draft = writing.Draft(user, new.description, new.owl)

        def add(connection: Connection) -> Entry:
            row = writing.add_version(connection, writing.insert(connection, header), draft)
            writing.index(connection, row, reading)
            writing.note(connection, row, "added", user)
            writing.check_quota(connection, user, self.limits.user)
            return records.entry_of(connection, Reader(user), row)

        return await self.write(add)

    async def change(self, reader: Reader, kind: Kind, uid: str, change: EntryChange) -> Entry:
        """Change an entry of the reader.

        Raises:
            NotFound: There is no such entry.
            Forbidden: It is somebody else's.
            InvalidRequest: The OWL text is refused.
            LimitExceeded: The quota is used up.
        """
        while (changed := await self._change(reader, kind, uid, change)) is None:
            pass  # another change came first
        return changed

    async def _change(self, reader: Reader, kind: Kind, uid: str, change: EntryChange) -> Entry | None:
        """Change an entry; return None if it has another text since this one was read."""
        await self.database.run(lambda connection: records.find_own(connection, reader, kind, uid))
        text = (await self.text(reader, kind, uid)).text if change.owl is UNSET else change.owl
        has_version = change.owl is not UNSET or change.description is not UNSET
        reading = await self.texts.read(reader.user, graph_of(kind, uid), text) if has_version else None

        def apply(connection: Connection) -> Entry | None:
            row = records.find_own(connection, reader, kind, uid)
            newest = writing.newest(connection, row)
            if has_version and change.owl is UNSET and newest.text != text:
                return None
            if change.shared is not UNSET:
                writing.set_readers(connection, row["id"], change.shared)
            if change.public is not UNSET:
                writing.set_public(connection, row["id"], change.public)
            if change.location is not UNSET:
                writing.set_location(connection, row["id"], change.location)
            if reading is not None:
                draft = replace(newest, author=reader.user, text=text)
                if change.description is not UNSET:
                    draft = replace(draft, description=change.description)
                row = writing.add_version(connection, row, draft)
                writing.index(connection, row, reading)
            return self._changed_entry(connection, reader, row)

        return await self.write(apply)

    async def put_file(self, reader: Reader, kind: Kind, uid: str, name: str, pieces: AsyncIterator[bytes]) -> Entry:
        """Add or replace a file of an entry of the reader; raises as `change`."""
        check_file_name(name)
        await self.database.run(lambda connection: records.find_own(connection, reader, kind, uid))
        received = await self.contents.receive(pieces)
        file = StoredFile(name, received.size, received.sha256)

        def put(connection: Connection) -> Entry:
            found = self._with_files(connection, reader, kind, uid, lambda files: files | {name: file})
            self.contents.keep(received)
            return found

        try:
            return await self.write(put)
        finally:
            self.contents.discard(received)

    async def remove_file(self, reader: Reader, kind: Kind, uid: str, name: str) -> Entry:
        """Remove a file from the newest version; earlier ones keep it. Raises as `change`."""

        def without(files: dict[str, StoredFile]) -> dict[str, StoredFile]:
            if name not in files:
                raise NotFound(f"the {kind} {uid} has no file {name[:80]!r}", field="file")
            return {each: file for each, file in files.items() if each != name}

        return await self.write(lambda connection: self._with_files(connection, reader, kind, uid, without))

    def _with_files(
        self,
        connection: Connection,
        reader: Reader,
        kind: Kind,
        uid: str,
        edit: Callable[[dict[str, StoredFile]], dict[str, StoredFile]],
    ) -> Entry:
        row = records.find_own(connection, reader, kind, uid)
        draft = writing.newest(connection, row)
        files = edit({file.name: file for file in draft.files})
        row = writing.add_version(connection, row, replace(draft, author=reader.user, files=list(files.values())))
        return self._changed_entry(connection, reader, row)

    def _changed_entry(self, connection: Connection, reader: Reader, row: Row) -> Entry:
        row = records.find(connection, reader, row["kind"], row["uid"])  # who may read it may have changed
        writing.note(connection, row, "changed", reader.user)
        writing.check_quota(connection, row["author"], self.limits.user)
        return records.entry_of(connection, reader, row)

    async def rate(self, reader: Reader, kind: Kind, uid: str, rating: float) -> Entry:
        """Rate an entry that the reader may read; return it with its new rating."""

        def rate(connection: Connection) -> Entry:
            row = records.find(connection, reader, kind, uid)
            query = "UPDATE entries SET rating = rating + (? - rating) / 10 WHERE id = ?"
            connection.execute(query, (rating, row["id"]))
            return records.entry_of(connection, reader, records.find(connection, reader, kind, uid))

        return await self.write(rate)

    async def remove(self, reader: Reader, kind: Kind, uid: str) -> None:
        """Remove an entry of the reader with all of its versions; raises as `change`."""

        def remove(connection: Connection) -> list[str]:
            row = records.find_own(connection, reader, kind, uid)
            writing.note(connection, row, "removed", reader.user)
            return writing.remove(connection, row)

        await self._remove_files(await self._write(remove))

    async def forget(self, user: str) -> None:
        """Remove all entries of a user who was removed, and the user from the readers of others."""

        def forget(connection: Connection) -> list[str]:
            return writing.forget_user(connection, user)

        await self._remove_files(await self._write(forget))

    async def remove_version(self, reader: Reader, kind: Kind, uid: str, number: int) -> None:
        """Remove an old version of an entry of the reader; raises as `change`."""

        def remove(connection: Connection) -> list[str]:
            return writing.remove_version(connection, records.find_own(connection, reader, kind, uid), number)

        await self._remove_files(await self._write(remove))

    async def _remove_files(self, digests: list[str]) -> None:
        """Remove files, but for those that came back meanwhile."""
        if digests:
            await self.database.run(
                lambda connection: self.contents.remove(set(digests) - writing.known_digests(connection))
            )

    async def write(self, work: Callable[[Connection], T]) -> T:
        """Do work that changes entries, and wake those who wait for changes.

        Raises:
            DiskFull: There is no room on the disk.
        """
        self.contents.check_space()
        return await self._write(work)

    async def _write(self, work: Callable[[Connection], T]) -> T:
        """Do the same for work that needs no room, such as a removal."""
        result = await self.database.run(work)
        _changes.add()
        event, self._changed = self._changed, asyncio.Event()
        event.set()
        return result

    # --- subscriptions -----------------------------------------------------------------------------------------------

    def next_change(self) -> asyncio.Event:
        """Return an event that is set by the next change. Take it before you look for changes."""
        return self._changed

    async def changes(self, reader: Reader, wanted: Subscription, after: int | None) -> tuple[list[Change], int]:
        """Return changes after a number, and the number up to which that are all; without one, only that number."""
        return await self.database.run(lambda connection: read_changes(connection, reader, wanted, after))

    async def noted(self, after: int) -> tuple[list[NotedChange], int]:
        """Return all changes after a number, some hundred at most, and the number of the last one."""
        return await self.database.run(lambda connection: read_noted(connection, after))

    async def stop(self) -> None:
        """Close everything."""
        await self.texts.stop()
        self.database.close()
