"""Messages between the service and its workers: MessagePack with the length before it."""

from __future__ import annotations

import struct

import msgspec
from msgspec import Struct

from rce.api.knowledge import QueryResult
from rce.errors import ErrorInfo

HEADER = struct.Struct("!I")


class Document(Struct, frozen=True):
    """OWL text to read; relative IRIs in it refer to `base`."""

    base: str
    text: str


class Reading(Struct, frozen=True):
    """Content of an OWL text.

    Attributes:
        triples: The content as N-Triples.
        count: Number of triples.
        types: IRIs of the classes of which it has individuals, or which it places below others.
        subclasses: Pairs of a class and one above it.
        words: Labels, comments and names, for the search of texts.
        refused: Why the text is refused, and the rest is empty.
    """

    triples: bytes = b""
    count: int = 0
    types: list[str] = []
    subclasses: list[tuple[str, str]] = []
    words: str = ""
    refused: ErrorInfo | None = None


class Load(Struct, frozen=True, tag="load"):
    """Set a named graph. There is no reply."""

    graph: str
    triples: bytes


class Drop(Struct, frozen=True, tag="drop"):
    """Remove a named graph. There is no reply."""

    graph: str


class Read(Struct, frozen=True, tag="read"):
    """Read texts; the reply is Readings."""

    documents: list[Document]
    seconds: float
    memory: int  # bytes beside what the worker has already


class Evaluate(Struct, frozen=True, tag="evaluate"):
    """Answer a SPARQL query; the reply is Answered."""

    query: str
    seconds: float
    memory: int
    rows: int  # maximum number


class Readings(Struct, frozen=True, tag="readings"):
    """Reading of each text."""

    results: list[Reading]


class Answered(Struct, frozen=True, tag="answered"):
    """Result of a query."""

    result: QueryResult


class Failed(Struct, frozen=True, tag="failed"):
    """The work was refused, or exceeded its limits."""

    error: ErrorInfo


Command = Load | Drop | Read | Evaluate
Reply = Readings | Answered | Failed
_commands = msgspec.msgpack.Decoder(Command)
_replies = msgspec.msgpack.Decoder(Reply)


def pack(message: Command | Reply) -> bytes:
    """Return a message with its length."""
    body = msgspec.msgpack.encode(message)
    return HEADER.pack(len(body)) + body


def command(body: bytes) -> Command:
    """Return a command without its length."""
    found: Command = _commands.decode(body)
    return found


def reply(body: bytes) -> Reply:
    """Return a reply without its length."""
    found: Reply = _replies.decode(body)
    return found
