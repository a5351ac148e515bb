"""Requests of environments to the knowledge service, which come over the platform and not by HTTP.

A node sends them to the UNIX socket of its environment, whose path is in the variable SOCKET: four bytes with the
length, big-endian, and a request as msgpack; the answer comes in the same form. Contents travel in pieces, because the
messages of an environment are small.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from rce.api.knowledge import Change, EntryChange, Kind, NewEntry, QueryResult
from rce.errors import ErrorInfo

SOCKET = "RCE_KNOWLEDGE"  # variable of nodes
MAX_FRAME = 1024 * 1024  # bytes of a request and of an answer
PIECE = 256 * 1024  # bytes of a content in one request
MAX_FOUND = 100  # entries of an answer

Uid = Annotated[str, Meta(max_length=241)]
FileName = Annotated[str, Meta(max_length=255)]
Version = Annotated[int, Meta(ge=1, lt=2**31)]


class FindEntries(Struct, frozen=True, tag=True):
    """Find the first entries whose uids begin with a prefix, or with `exact` the one that has this uid."""

    kind: Kind
    prefix: Uid
    exact: bool = False


class ReadContent(Struct, frozen=True, tag=True):
    """Read a piece of a file of a version, or of its OWL text if `file` is empty."""

    kind: Kind
    uid: Uid
    version: Version
    file: FileName = ""
    offset: Annotated[int, Meta(ge=0)] = 0


class RunQuery(Struct, frozen=True, tag=True):
    """Answer a query in the SeRQL of RoboEarth's clients."""

    query: Annotated[str, Meta(min_length=1, max_length=20_000)]


class WaitForChanges(Struct, frozen=True, tag=True):
    """Return the changes after a number, once there are some, or none after `seconds`.

    Without `after` only the number of the newest change is returned, at once.
    """

    after: Annotated[int, Meta(ge=0, lt=2**53)] | None = None
    seconds: Annotated[float, Meta(ge=0, le=30)] = 20.0


class AddEntry(Struct, frozen=True, tag=True):
    """Add an entry."""

    new: NewEntry


class ChangeEntry(Struct, frozen=True, tag=True):
    """Change an entry."""

    kind: Kind
    uid: Uid
    change: EntryChange


class RemoveEntry(Struct, frozen=True, tag=True):
    """Remove an entry."""

    kind: Kind
    uid: Uid


class PutPiece(Struct, frozen=True, tag=True):
    """Send a piece of a file, in order; with the last one the file is added or replaced.

    `upload` is a random name that the pieces of a file have in common.
    """

    kind: Kind
    uid: Uid
    file: FileName
    upload: Annotated[str, Meta(min_length=16, max_length=64)]
    offset: Annotated[int, Meta(ge=0)]
    data: Annotated[bytes, Meta(max_length=PIECE)]
    last: bool


class RemoveFile(Struct, frozen=True, tag=True):
    """Remove a file from the newest version of an entry."""

    kind: Kind
    uid: Uid
    file: FileName


Reading = FindEntries | ReadContent | RunQuery | WaitForChanges
Writing = AddEntry | ChangeEntry | RemoveEntry | PutPiece | RemoveFile
KnowledgeRequest = Reading | Writing


class Found(Struct, frozen=True):
    """Entry that was found, with the number of its newest version and the names of its files."""

    uid: str
    version: int
    files: list[str] = []


class KnowledgeAnswer(Struct, frozen=True):
    """Answer to a request: entries, a piece of a content of `size` bytes, the result of a query, or changes.

    `newest` is the number up to which the changes are all.
    """

    entries: list[Found] = []
    data: bytes = b""
    size: int = 0
    result: QueryResult | None = None
    changes: list[Change] = []
    newest: int = 0


class Reply(Struct, frozen=True):
    """Reply at the socket: an answer, or an error."""

    answer: KnowledgeAnswer | None = None
    error: ErrorInfo | None = None
