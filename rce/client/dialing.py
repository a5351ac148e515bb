"""Opening a TCP connection over a line that loses packets or is interrupted for a while."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Any

from websockets.proxy import get_proxy
from websockets.uri import parse_uri

INTERVAL = 0.4  # seconds between two attempts; the kernel alone tries again after 1, 3 and 7 s
ATTEMPT = 3.0  # seconds that one attempt may take
# Errors while a network is away, which may be back soon. Others, as a refusal, are answers of the other side.
_AWAY = {errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN, errno.EHOSTDOWN, errno.EADDRNOTAVAIL, errno.ETIMEDOUT}

Attempt = asyncio.Task[socket.socket | None]


def proxy_of(uri: str) -> str | None:
    """Return the URL of the proxy that is configured for a WebSocket URI, if there is one.

    Raises:
        InvalidURI: The URI is not that of a WebSocket.
    """
    return get_proxy(parse_uri(uri))


async def dial(host: str, port: int, seconds: float) -> socket.socket:
    """Connect to a host, and begin another attempt every INTERVAL seconds until one succeeds.

    So the connection is open about a round trip after the line is back.

    Args:
        host: Name or address of the host.
        port: The port.
        seconds: Time for all attempts.

    Returns:
        The connected socket, which does not block.

    Raises:
        TimeoutError: None succeeded in time.
        OSError: The other side refused the connection.
    """
    attempts: set[Attempt] = set()
    async with asyncio.timeout(seconds):
        try:
            while True:
                attempts.add(asyncio.create_task(_attempt(host, port)))
                async for ended in _ended_within(attempts, INTERVAL):
                    attempts.discard(ended)
                    if (connected := ended.result()) is not None:
                        return connected
        finally:
            await _abandon(attempts)


async def _ended_within(attempts: set[Attempt], seconds: float) -> AsyncIterator[Attempt]:
    """Yield the attempts that end within some seconds, as they end."""
    turn = asyncio.create_task(asyncio.sleep(seconds))
    try:
        while not turn.done():
            done, _ = await asyncio.wait({*attempts, turn}, return_when=asyncio.FIRST_COMPLETED)
            for each in attempts & done:
                yield each
    finally:
        turn.cancel()


async def _attempt(host: str, port: int) -> socket.socket | None:
    """Connect to the first address that answers; return None if the network is away."""
    loop = asyncio.get_running_loop()
    try:
        async with asyncio.timeout(ATTEMPT):
            found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
            for family, _, _, _, address in found[:-1]:
                with suppress(OSError):  # the next address may answer
                    return await _connect(family, address)
            return await _connect(found[-1][0], found[-1][4])
    except TimeoutError:
        return None
    except OSError as error:  # also of the name resolution
        if error.errno in _AWAY or error.errno == socket.EAI_AGAIN:
            return None
        raise


async def _connect(family: int, address: tuple[Any, ...]) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_STREAM)
    try:
        sock.setblocking(False)
        # asyncio does so only for sockets that name their protocol. A message with bytes is two frames, of which the
        # second would wait 40 ms for the delayed acknowledgement of the first.
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        await asyncio.get_running_loop().sock_connect(sock, address)
    except BaseException:
        sock.close()
        raise
    return sock


async def _abandon(attempts: set[Attempt]) -> None:
    """End attempts that lost; one may have connected meanwhile."""
    for attempt in attempts:
        attempt.cancel()
    for outcome in await asyncio.gather(*attempts, return_exceptions=True):
        if isinstance(outcome, socket.socket):
            outcome.close()


def address_is_gone(sock: Any) -> bool:
    """Return whether this machine has lost the address of a connection, so that no answer can arrive.

    Args:
        sock: The connected socket; None if there is none to look at.
    """
    if sock is None or sock.family not in (socket.AF_INET, socket.AF_INET6):
        return False
    try:
        host, _, *more = sock.getsockname()
        with socket.socket(sock.family, socket.SOCK_DGRAM) as probe:
            probe.bind((host, 0, *more))
    except OSError as error:
        return error.errno == errno.EADDRNOTAVAIL
    return False
