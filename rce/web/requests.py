"""Reading of requests as they were sent: aiohttp's own properties decode, normalise and fail on what is malformed."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator

from aiohttp import HttpVersion11, web

from rce.errors import Forbidden

BODY_TIMEOUT = 60.0  # seconds for a body, and without any byte of it
MIN_RATE = 1024  # bytes of a body that extend its time by a second
READ_METHODS = ("GET", "HEAD", "OPTIONS")
_HOST = re.compile(r"\[?(?P<name>.*?)\]?(:\d+)?", re.DOTALL)


def raw_path(request: web.BaseRequest) -> str:
    """Return the path as it was sent, without the query."""
    return request.raw_path.partition("?")[0]


def raw_query(request: web.BaseRequest) -> str:
    """Return the query as it was sent; empty without one."""
    return request.raw_path.partition("?")[2]


def header(request: web.BaseRequest, name: str) -> str | None:
    """Return a header, the last of several; what is not UTF-8 in it is replaced."""
    values = request.headers.getall(name, [])
    return values[-1].encode("utf-8", "surrogateescape").decode("utf-8", "replace") if values else None


def host_name(request: web.BaseRequest) -> str:
    """Return the name or address in the Host header, without port and brackets; without it that of the socket."""
    found = _HOST.fullmatch(header(request, "Host") or "")
    if found is not None and found["name"]:
        return found["name"].encode("ascii", "replace").decode()
    address = request.get_extra_info("sockname")
    return str(address[0]) if isinstance(address, tuple) else ""


def peer_address(request: web.BaseRequest) -> str:
    """Return the address from which the request came."""
    return request.remote or ""


def declared_length(request: web.BaseRequest) -> int | None:
    """Return the number of bytes of the body; None for a chunked one, whose end is not known."""
    return None if "Transfer-Encoding" in request.headers else request.content_length or 0


def check_same_site(request: web.BaseRequest) -> None:
    """Refuse changes that a page of another site has a browser ask for.

    Programs send neither of the two headers. Browsers send `Sec-Fetch-Site` over https and to localhost, and `Origin`
    with every change.

    Raises:
        Forbidden: The page is of another site.
    """
    if request.method in READ_METHODS:
        return
    site, origin = header(request, "Sec-Fetch-Site"), header(request, "Origin")
    if site is None and origin is not None:
        host = (header(request, "Host") or "").lower()
        site = "same-origin" if origin.lower().partition("://")[2] == host else "cross-site"
    if site not in (None, "same-origin", "none"):
        raise Forbidden(f"this request comes from a page of another site ({(origin or site)[:80]})", field="Origin")


def check_encoding(request: web.BaseRequest) -> None:
    """Refuse compressed bodies: their size is not known in advance.

    Raises:
        web.HTTPUnsupportedMediaType: The body is compressed.
    """
    encoding = header(request, "Content-Encoding") or "identity"
    if encoding.strip().lower() != "identity":
        reason = f"the body must come as it is, not with Content-Encoding: {encoding[:80]}"
        raise web.HTTPUnsupportedMediaType(text=reason, headers={"Accept-Encoding": "identity"})


async def accept_body(request: web.BaseRequest) -> None:
    """Tell a client that asked first (`Expect: 100-continue`) to send its body."""
    if request.version >= HttpVersion11 and (header(request, "Expect") or "").lower() == "100-continue":
        await request.writer.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        request.writer.output_size = 0  # it is no part of the response


async def read_body(request: web.BaseRequest) -> bytes:
    """Ask for the body if the client waits for that, and return all of it.

    Raises:
        web.HTTPException: As `read_accepted_body`.
    """
    await accept_body(request)
    return await read_accepted_body(request)


async def read_accepted_body(request: web.BaseRequest) -> bytes:
    """Return the whole body, for which the client has been asked: routes of a web.Application do that themselves.

    Raises:
        web.HTTPException: As `body_pieces`, or the body is larger than the server takes.
    """
    body = bytearray()
    async for piece in body_pieces(request):
        body += piece
        if len(body) > request.client_max_size:
            raise web.HTTPRequestEntityTooLarge(request.client_max_size)
    return bytes(body)


async def body_pieces(request: web.BaseRequest) -> AsyncIterator[bytes]:
    """Yield the body as it comes.

    Raises:
        web.HTTPUnsupportedMediaType: It is compressed.
        web.HTTPRequestTimeout: Nothing came for BODY_TIMEOUT, or the whole comes too slowly.
        web.HTTPBadRequest: It is malformed.
        ConnectionError: The client disconnected.
    """
    check_encoding(request)
    loop = asyncio.get_running_loop()
    left = BODY_TIMEOUT
    while True:
        began = loop.time()
        try:
            async with asyncio.timeout(min(left, BODY_TIMEOUT)):
                piece = await request.content.readany()
        except TimeoutError:
            raise web.HTTPRequestTimeout(text="the body came too slowly") from None
        except web.RequestPayloadError:
            raise web.HTTPBadRequest(text="the body is malformed") from None
        if not piece:
            return
        left += len(piece) / MIN_RATE - (loop.time() - began)
        yield piece
