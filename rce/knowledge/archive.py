"""Export and import of the repository as one archive: a ZIP file with entries, texts and files.

`format.json` has the version of the format, `entries/KIND/UID.json` an entry with all of its versions, `texts/` and
`files/` the contents by their SHA-256.
"""

from __future__ import annotations

import asyncio
import errno
import hashlib
import zipfile
import zlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from itertools import islice
from pathlib import Path
from sqlite3 import Connection

import msgspec

from rce.api.knowledge import Imported, Kind
from rce.errors import AlreadyExists, InvalidRequest, LimitExceeded, RceError, Unavailable
from rce.knowledge import records, writing
from rce.knowledge.contents import Received, flush
from rce.knowledge.messages import Document, Reading
from rce.knowledge.names import graph_of
from rce.knowledge.packed import (
    ArchivedEntry,
    ArchivedVersion,
    Format,
    open_archive,
    open_member,
    read_entries,
    read_record,
    read_text,
    some_texts,
)
from rce.knowledge.records import Reader
from rce.knowledge.repository import Repository

FORMAT = 1
TOGETHER = 100  # entries that are exported at once
ADDED_TOGETHER = 10  # entries that are added in one transaction


class Archive:
    """Exports and imports a repository."""

    def __init__(self, repository: Repository) -> None:
        self._repository = repository
        self._exporting: set[Reader] = set()

    # --- export ------------------------------------------------------------------------------------------------------

    @asynccontextmanager
    async def export(self, reader: Reader) -> AsyncIterator[Path]:
        """Make an archive of all entries that a reader may read; it is removed at the end.

        Raises:
            Unavailable: An entry was removed meanwhile, or the disk is full.
            LimitExceeded: An archive for this reader is in progress.
        """
        if reader in self._exporting:
            raise LimitExceeded("an export of yours is in progress: wait until it is complete")
        self._exporting.add(reader)
        path = self._repository.contents.draft()
        try:
            with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr("format.json", msgspec.json.encode(Format(FORMAT)))
                await self._export(reader, archive)
            yield path
        finally:
            self._exporting.discard(reader)
            path.unlink(missing_ok=True)

    async def _export(self, reader: Reader, archive: zipfile.ZipFile) -> None:
        query = f"SELECT id FROM entries e WHERE {records.READABLE} ORDER BY id"
        ids = await self._repository.database.run(
            lambda connection: [row[0] for row in connection.execute(query, reader.parameters)]
        )
        seen: set[str] = set()
        for start in range(0, len(ids), TOGETHER):
            part = ids[start : start + TOGETHER]
            found = await self._repository.database.run(partial(_entries, reader=reader, ids=part))
            await asyncio.to_thread(self._pack, archive, found, seen)

    def _pack(
        self, archive: zipfile.ZipFile, found: list[tuple[ArchivedEntry, dict[str, str]]], seen: set[str]
    ) -> None:
        for entry, texts in found:
            self._repository.contents.check_space()
            archive.writestr(f"entries/{entry.kind}/{entry.uid}.json", msgspec.json.encode(entry))
            for digest, text in texts.items():
                if f"texts/{digest}" not in seen:
                    seen.add(f"texts/{digest}")
                    archive.writestr(f"texts/{digest}", text)
            for digest in {file.sha256 for version in entry.versions for file in version.files}:
                if f"files/{digest}" not in seen:
                    seen.add(f"files/{digest}")
                    try:
                        archive.write(self._repository.contents.path(digest), f"files/{digest}")
                    except FileNotFoundError:
                        raise Unavailable(f"the {entry.kind} {entry.uid} was removed meanwhile: try again") from None

    # --- import ------------------------------------------------------------------------------------------------------

    async def restore(self, reader: Reader, pieces: AsyncIterator[bytes]) -> Imported:
        """Add the entries of an archive; those whose uids exist stay as they are.

        Entries become the reader's own, with new ratings, unless the reader may change everything.

        Raises:
            InvalidRequest: The archive is malformed, or a text is refused. Entries before it have been added.
            LimitExceeded: The quota is used up, or the archive has too many members.
        """
        contents = self._repository.contents
        received = await contents.receive(pieces)
        try:
            with await asyncio.to_thread(open_archive, received.path) as archive:
                return await self._restore(reader, archive)
        # The last two are raised for members of a later version of ZIP, and for encrypted ones.
        except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
            raise InvalidRequest(f"this is not an archive of a repository: {error}") from None
        except OSError as error:
            if error.errno != errno.EINVAL:
                raise
            raise InvalidRequest("this is not an archive of a repository: its directory is damaged") from None
        finally:
            contents.discard(received)

    async def _restore(self, reader: Reader, archive: zipfile.ZipFile) -> Imported:
        if read_record(archive, "format.json", Format).format != FORMAT:
            raise InvalidRequest(f"the archive is not of the format {FORMAT}: a newer version of RCE has made it")
        names = iter([name for name in archive.namelist() if name.startswith("entries/")])
        added, skipped = 0, list[str]()
        while part := list(islice(names, ADDED_TOGETHER)):
            entries = await asyncio.to_thread(read_entries, archive, part)
            present = await self._repository.database.run(partial(_present, entries=entries))
            for entry in entries:
                if (entry.kind, entry.uid) in present:
                    skipped.append(f"{entry.kind}/{entry.uid}")
            new = [entry for entry in entries if (entry.kind, entry.uid) not in present]
            added += await self._add(reader, archive, new)
        return Imported(added, skipped)

    async def _add(self, reader: Reader, archive: zipfile.ZipFile, entries: list[ArchivedEntry]) -> int:
        readings = await self._readings(reader.user, archive, entries)
        files: list[Received] = []
        try:
            await asyncio.to_thread(self._unpack, archive, entries, files)
            await self._repository.write(
                lambda connection: self._insert(connection, reader, archive, entries, readings, files)
            )
        finally:
            for file in files:
                self._repository.contents.discard(file)
        return len(entries)

    async def _readings(
        self, user: str, archive: zipfile.ZipFile, entries: list[ArchivedEntry]
    ) -> dict[tuple[Kind, str], Reading]:
        """Read the texts of all versions, and return the readings of the newest.

        Raises:
            InvalidRequest: A text is refused.
        """
        found: dict[tuple[Kind, str], Reading] = {}
        wanted = ((entry, digest) for entry in entries for digest in {version.owl for version in entry.versions})
        while part := await asyncio.to_thread(some_texts, archive, wanted):
            documents = [Document(graph_of(entry.kind, entry.uid), text) for entry, _, text in part]
            readings = await self._repository.texts.read_all(user, documents)
            for (entry, digest, _), reading in zip(part, readings, strict=True):
                if reading.refused is not None:
                    error = RceError.from_info(reading.refused)
                    raise InvalidRequest(f"the {entry.kind} {entry.uid}: {error}", field=error.field)
                if digest == entry.versions[-1].owl:
                    found[entry.kind, entry.uid] = reading
        return found

    def _unpack(self, archive: zipfile.ZipFile, entries: list[ArchivedEntry], found: list[Received]) -> None:
        """Unpack the files of entries into `found`, and check them."""
        contents = self._repository.contents
        wanted = {file.sha256: file.size for entry in entries for each in entry.versions for file in each.files}
        for digest, size in wanted.items():
            contents.check_space()
            path = contents.draft()
            found.append(Received(path, size, digest))
            check = hashlib.sha256()
            with open_member(archive, f"files/{digest}", size) as source, path.open("wb") as out:
                while piece := source.read(1024 * 1024):
                    check.update(piece)
                    out.write(piece)
                flush(out)
            if check.hexdigest() != digest or path.stat().st_size != size:
                raise InvalidRequest(f"files/{digest} of the archive is damaged")

    def _insert(
        self,
        connection: Connection,
        reader: Reader,
        archive: zipfile.ZipFile,
        entries: list[ArchivedEntry],
        readings: dict[tuple[Kind, str], Reading],
        files: list[Received],
    ) -> None:
        for entry in entries:
            author = entry.author if reader.everything else reader.user
            rating = entry.rating if reader.everything else writing.NEW_RATING
            header = writing.Header(
                entry.kind, entry.uid, author, entry.public, entry.shared, entry.location, rating, entry.created
            )
            try:
                row = writing.insert(connection, header)
            except AlreadyExists:
                raise Unavailable(f"the {entry.kind} {entry.uid} was added meanwhile: try again") from None
            for version in entry.versions:
                by = version.author if reader.everything else reader.user
                draft = writing.Draft(
                    by, version.description, read_text(archive, version.owl), version.files, version.time
                )
                row = writing.add_version(connection, row, draft)
            writing.index(connection, row, readings[entry.kind, entry.uid])
            writing.note(connection, row, "added", reader.user)
        for author in {entry.author for entry in entries} if reader.everything else {reader.user}:
            writing.check_quota(connection, author, self._repository.limits.user)
        for file in files:
            self._repository.contents.keep(file)


def _entries(connection: Connection, reader: Reader, ids: list[int]) -> list[tuple[ArchivedEntry, dict[str, str]]]:
    """Return entries with their texts by digest."""
    found = []
    numbers = ",".join(map(str, ids))
    rows = connection.execute(f"SELECT * FROM entries WHERE id IN ({numbers})").fetchall()
    for row, entry in zip(rows, records.entries_of(connection, reader, rows) if rows else [], strict=True):
        texts, versions = dict[str, str](), []
        for number in sorted(version.number for version in records.versions_of(connection, row)):
            version = records.find_version(connection, row, number)
            texts[version["sha256"]] = records.text_of(connection, version)
            files = records.files_of(connection, row["id"], number)
            stamp = (version["time"], version["author"], version["description"], version["sha256"])
            versions.append(ArchivedVersion(*stamp, files))
        header = (entry.kind, entry.uid, entry.author, entry.created, entry.rating)
        found.append((ArchivedEntry(*header, versions, entry.public, entry.shared, entry.location), texts))
    return found


def _present(connection: Connection, entries: list[ArchivedEntry]) -> set[tuple[str, str]]:
    query = "SELECT 1 FROM entries WHERE kind = ? AND uid = ?"
    names = [(entry.kind, entry.uid) for entry in entries]
    return {name for name in names if connection.execute(query, name).fetchone()}
