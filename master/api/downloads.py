"""Downloads of what other processes have, in pieces: whole files or ranges of them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager, nullcontext

from aiohttp import web
from twisted.logger import Logger

from rce.errors import InvalidRequest, RceError

log = Logger()
ReadPiece = Callable[[int, int], Awaitable[bytes]]
"""Returns a piece at an offset, of at most so many bytes; an empty one if the file is shorter."""
PARTIAL, WRONG_RANGE = 206, 416


class Download:
    """One answer with a file; the next piece is read while one is sent, and no more are held."""

    def __init__(
        self,
        name: str,
        size: int,
        read: ReadPiece,
        held: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        """Prepare an answer.

        Args:
            name: Name for the client's file.
            size: Bytes of the file.
            read: Reads a piece of it.
            held: Context in which it is sent.
        """
        self._name = name
        self._size = size
        self._read = read
        self._held = held

    async def send(self, request: web.BaseRequest, headers: dict[str, str]) -> web.StreamResponse:
        """Send the file, or the range of it that the request asks for.

        Raises:
            InvalidRequest: The header Range is malformed.
            RceError: The first piece cannot be read.
        """
        with self._held():
            return await self._answer(request, headers)

    async def _answer(self, request: web.BaseRequest, headers: dict[str, str]) -> web.StreamResponse:
        headers |= {
            "Accept-Ranges": "bytes",
            "Content-Type": "application/octet-stream",
            "Content-Disposition": f'attachment; filename="{self._name}"',
        }
        begin, end = self._range(request)
        if begin >= end and self._size:
            return web.Response(status=WRONG_RANGE, headers=headers | {"Content-Range": f"bytes */{self._size}"})
        part = "Range" in request.headers
        if part:
            headers["Content-Range"] = f"bytes {begin}-{end - 1}/{self._size}"
        first = await self._read(begin, end - begin) if request.method != "HEAD" else b""
        response = web.StreamResponse(status=PARTIAL if part else 200, headers=headers)
        response.content_length = end - begin
        await response.prepare(request)
        if request.method != "HEAD":
            await self._send(request, response, begin, end, first)
        return response

    def _range(self, request: web.BaseRequest) -> tuple[int, int]:
        """Return the range that is asked for, without its end."""
        try:
            wanted = request.http_range
        except ValueError:
            raise InvalidRequest("write Range: bytes=FIRST-LAST", field="Range") from None
        begin, end, _ = wanted.indices(self._size)
        return begin, end

    async def _send(
        self, request: web.BaseRequest, response: web.StreamResponse, begin: int, end: int, piece: bytes
    ) -> None:
        try:
            while piece:
                begin += len(piece)
                coming = asyncio.ensure_future(self._read(begin, end - begin)) if begin < end else None
                try:
                    await response.write(piece)
                    piece = await coming if coming is not None else b""
                finally:
                    if coming is not None:
                        coming.cancel()
            if begin == end:
                await response.write_eof()
                return
            reason = "the file became shorter"
        except RceError as error:
            reason = str(error)
        log.warn("a download of {name} broke off: {reason}", name=self._name, reason=reason)
        if request.transport is not None:  # the response has begun: it can only be broken off
            request.transport.abort()
