"""The entry on a port: a recording that a client sends to the Master is redirected before any of it is taken.

Twisted keeps the body of a request, in a file if it is large, until all of it is there; only then is the request looked
at. So a request with a large body is answered as soon as its headers are there, and its connection closed. Clients that
send `Expect: 100-continue`, as curl does, have sent nothing by then.
"""

from __future__ import annotations

import io
from typing import Any, AnyStr

from twisted.web.server import Request, Site

from master.entry import Entry
from rce.errors import Unavailable

BODY_MOST = 65_536  # bytes; nothing that the entry itself answers has a body


class EntryRequest(Request):
    """A request whose body is not waited for where it is too large to be for the Master itself."""

    def getHeader(self, key: AnyStr) -> AnyStr | None:
        """Twisted's fails, and hangs up, where a value is not UTF-8."""
        if isinstance(key, bytes):
            return super().getHeader(key)
        value = super().getHeader(key.encode())
        return None if value is None else value.decode("utf-8", "replace")

    def gotLength(self, length: int | None) -> None:
        if length is not None and length <= BODY_MOST:
            super().gotLength(length)
            return
        self.content = io.BytesIO()
        self.requestHeaders.removeHeader(b"Expect")  # else the body would still be asked for
        channel: Any = self.channel
        channel.transport.write(self._answer(channel._path))  # the path is public only once the body is there
        channel.loseConnection()

    def _answer(self, uri: bytes) -> bytes:
        channel: Any = self.channel
        entry: Entry = channel.site.entry
        status = b"413 Content Too Large"
        try:
            location = entry.location(uri, self.getRequestHostname())
            if location:
                status = b"307 Temporary Redirect\r\nLocation: " + location
        except Unavailable:
            status = b"503 Service Unavailable"
        return b"HTTP/1.1 " + status + b"\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"

    def handleContentChunk(self, data: bytes) -> None:
        channel: Any = self.channel
        if not channel.transport.disconnecting:  # else it was answered already
            super().handleContentChunk(data)


class EntrySite(Site):
    """The entry of one Master."""

    requestFactory = EntryRequest

    def __init__(self, entry: Entry) -> None:
        super().__init__(entry)
        self.entry = entry
