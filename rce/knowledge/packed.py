"""Reading of an archive of the repository, none of which is trusted."""

from __future__ import annotations

import hashlib
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Annotated, TypeVar

import msgspec
from msgspec import Meta, Struct

from rce.api.knowledge import MAX_OWL, Description, Kind, Location, Readers, StoredFile, User
from rce.errors import MALFORMED, InvalidRequest, LimitExceeded
from rce.knowledge.names import UID, check_file_name

END, LOCATOR, END_64 = struct.Struct("<4s4H2LH"), struct.Struct("<4sLQL"), struct.Struct("<4sQ2H2L4Q")
END_SIGNATURE, LOCATOR_SIGNATURE = b"PK\5\6", b"PK\6\7"
MAX_COMMENT = 0xFFFF
MAX_DIRECTORY = 32 * 1024 * 1024  # bytes; about 250,000 members, which take 150 MB of memory
READ_TOGETHER = 1024 * 1024  # characters of texts from which on no more are read at once
MAX_RECORD = 4 * 1024 * 1024  # bytes of an entry without its contents
Time = Annotated[float, Meta(ge=0, le=253_402_300_799)]  # seconds; to the year 9999, as calendars have it
Digest = Annotated[str, Meta(pattern=r"^[0-9a-f]{64}$(?!\n)")]
T = TypeVar("T")


class Format(Struct, frozen=True):
    """Version of the format."""

    format: int


class ArchivedVersion(Struct, frozen=True):
    """Version of an entry; `owl` is the digest of its text."""

    time: Time
    author: User
    description: Description
    owl: Digest
    files: list[StoredFile] = []


class ArchivedEntry(Struct, frozen=True):
    """Entry with all of its versions, the oldest first."""

    kind: Kind
    uid: str
    author: User
    created: Time
    rating: Annotated[float, Meta(ge=0, le=10)]
    versions: Annotated[list[ArchivedVersion], Meta(min_length=1, max_length=10_000)]
    public: bool = False
    shared: Readers = []
    location: Location | None = None


def open_archive(path: Path) -> zipfile.ZipFile:
    """Open an archive for reading. Its directory is read as a whole, so its size is checked first.

    Raises:
        LimitExceeded: It has too many members.
        zipfile.BadZipFile: It is no ZIP file.
    """
    size = _directory_size(path)
    if size > MAX_DIRECTORY:
        raise LimitExceeded(
            f"the directory of the archive has {size} bytes, more than {MAX_DIRECTORY}: split it", limit=MAX_DIRECTORY
        )
    return zipfile.ZipFile(path)


def _directory_size(path: Path) -> int:
    """Return the size of a ZIP file's directory, as its end tells (APPNOTE.TXT of PKWARE, 4.3.14 to 4.3.16).

    It is the largest that any record at the end has, because `zipfile` reads as much as one of them says.
    """
    with path.open("rb") as file:
        start = max(0, path.stat().st_size - END.size - MAX_COMMENT - LOCATOR.size)
        file.seek(start)
        tail = file.read()
        at = tail.rfind(END_SIGNATURE)
        if at < 0 or len(tail) - at < END.size:
            return 0  # not a ZIP file, as opening it tells
        sizes = [int(END.unpack_from(tail, at)[5])]
        if at >= LOCATOR.size and tail[at - LOCATOR.size :].startswith(LOCATOR_SIGNATURE):
            before = start + at - LOCATOR.size - END_64.size
            for place in (before, LOCATOR.unpack_from(tail, at - LOCATOR.size)[2]):
                file.seek(max(0, min(place, before)))
                record = file.read(END_64.size)
                if len(record) == END_64.size:
                    sizes.append(int(END_64.unpack(record)[8]))
        return max(sizes[1:] if len(sizes) > 1 and sizes[0] == 0xFFFFFFFF else sizes)


def read_entries(archive: zipfile.ZipFile, names: list[str]) -> list[ArchivedEntry]:
    """Return the entries that members of these names have; raises InvalidRequest."""
    return [_entry(archive, name) for name in names]


def _entry(archive: zipfile.ZipFile, name: str) -> ArchivedEntry:
    entry = read_record(archive, name, ArchivedEntry)
    if not UID.fullmatch(entry.uid):
        raise InvalidRequest(f"{name[:200]} of the archive has the malformed uid {entry.uid[:80]!r}")
    for version in entry.versions:
        names = {check_file_name(file.name) for file in version.files}
        if len(names) != len(version.files):
            raise InvalidRequest(f"{name[:200]} of the archive has two files of one name")
    return entry


def some_texts(
    archive: zipfile.ZipFile, wanted: Iterator[tuple[ArchivedEntry, str]]
) -> list[tuple[ArchivedEntry, str, str]]:
    """Take entries and digests until their texts have READ_TOGETHER characters; return these with the texts.

    Raises:
        InvalidRequest: A text is missing or damaged.
    """
    found, size = [], 0
    while size < READ_TOGETHER and (following := next(wanted, None)) is not None:
        text = read_text(archive, following[1])
        found.append((*following, text))
        size += len(text)
    return found


def read_text(archive: zipfile.ZipFile, digest: str) -> str:
    """Return a text; raises InvalidRequest."""
    with open_member(archive, f"texts/{digest}", 4 * MAX_OWL) as source:
        data = source.read(4 * MAX_OWL)
    if hashlib.sha256(data).hexdigest() != digest:
        raise InvalidRequest(f"texts/{digest} of the archive is damaged")
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise InvalidRequest(f"texts/{digest} of the archive is not UTF-8: {error}") from None
    if len(text) > MAX_OWL:
        raise InvalidRequest(f"texts/{digest} of the archive has more than {MAX_OWL} characters")
    return text


def read_record(archive: zipfile.ZipFile, name: str, kind: type[T]) -> T:
    """Return the JSON of a member as a value of this type; raises InvalidRequest."""
    with open_member(archive, name, MAX_RECORD) as source:
        try:
            return msgspec.json.decode(source.read(MAX_RECORD), type=kind)
        except MALFORMED as error:
            raise InvalidRequest(f"{name[:200]} of the archive is malformed: {error}") from None


def open_member(archive: zipfile.ZipFile, name: str, limit: int) -> IO[bytes]:
    """Open a member for reading.

    Raises:
        InvalidRequest: There is none of this name, it has more than `limit` bytes, or it is not plain or deflated.
    """
    try:
        info = archive.getinfo(name)
        if info.file_size > limit:
            raise InvalidRequest(f"{name[:200]} of the archive has more than {limit} bytes")
        if info.flag_bits & 1 or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InvalidRequest(f"{name[:200]} of the archive is encrypted, or compressed in another way than deflate")
        return archive.open(info)
    except KeyError:
        raise InvalidRequest(f"the archive has no {name[:200]}") from None
