"""Blocking client of the knowledge service for programs in an environment, over the platform and without a network."""

from __future__ import annotations

import os
import secrets
import socket
from pathlib import Path

import msgspec

from rce.api.knowledge import Kind, QueryResult
from rce.api.knowledge_requests import (
    MAX_FRAME,
    PIECE,
    SOCKET,
    FindEntries,
    Found,
    KnowledgeAnswer,
    KnowledgeRequest,
    PutPiece,
    ReadContent,
    Reply,
    RunQuery,
)
from rce.errors import MALFORMED, NotFound, RceError, Unavailable
from rce.net.sockets import unix_socket_path

TIMEOUT = 120.0  # seconds for an answer; longer than the platform takes at most


class EnvironmentKnowledge:
    """Client that connects anew for each request. It has the rights of the owner of the environment."""

    def __init__(self, path: Path | None = None) -> None:
        """Use the socket of the environment in which this program runs, or another one.

        Raises:
            Unavailable: This is no program in an environment.
        """
        given = path or os.environ.get(SOCKET)
        if not given:
            raise Unavailable(f"the variable {SOCKET} is not set: this is no node in an environment of the platform")
        self._path = Path(given)

    def ask(self, request: KnowledgeRequest) -> KnowledgeAnswer:
        """Send a request and return the answer.

        Raises:
            Unavailable: The environment does not answer.
            RceError: The service or the platform refuses the request.
        """
        try:
            reply = msgspec.msgpack.decode(self._exchange(msgspec.msgpack.encode(request)), type=Reply)
        except (OSError, *MALFORMED) as error:
            raise Unavailable(f"the knowledge socket of this environment: {error or type(error).__name__}") from None
        if reply.error is not None:
            raise RceError.from_info(reply.error)
        return reply.answer or KnowledgeAnswer()

    def find(self, kind: Kind, uid: str) -> Found:
        """Return an entry; raise NotFound."""
        found = self.ask(FindEntries(kind, uid, exact=True)).entries
        if not found:
            raise NotFound(f"there is no {kind} {uid[:120]!r}", field="uid")
        return found[0]

    def search(self, kind: Kind, prefix: str) -> list[Found]:
        """Return the first entries whose uids begin with a prefix."""
        return self.ask(FindEntries(kind, prefix)).entries

    def read(self, kind: Kind, found: Found, file: str = "") -> bytes:
        """Return a file of an entry, or its OWL text."""
        content = b""
        while True:
            answer = self.ask(ReadContent(kind, found.uid, found.version, file, len(content)))
            content += answer.data
            if not answer.data or len(content) >= answer.size:
                return content

    def put_file(self, kind: Kind, uid: str, name: str, content: bytes) -> None:
        """Add or replace a file of an entry of the owner."""
        upload = secrets.token_hex(16)
        for offset in range(0, len(content), PIECE) or (0,):
            data = content[offset : offset + PIECE]
            self.ask(PutPiece(kind, uid, name, upload, offset, data, last=offset + PIECE >= len(content)))

    def query(self, query: str) -> QueryResult:
        """Answer a query in the SeRQL of RoboEarth's clients."""
        return self.ask(RunQuery(query)).result or QueryResult()

    def _exchange(self, request: bytes) -> bytes:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(TIMEOUT)
            with unix_socket_path(self._path) as short:
                connection.connect(short)
            connection.sendall(len(request).to_bytes(4, "big") + request)
            length = int.from_bytes(_receive(connection, 4), "big")
            return _receive(connection, min(length, MAX_FRAME))


def _receive(connection: socket.socket, size: int) -> bytes:
    received = b""
    while len(received) < size:
        piece = connection.recv(size - len(received))
        if not piece:
            raise ConnectionResetError("the connection was closed")
        received += piece
    return received
