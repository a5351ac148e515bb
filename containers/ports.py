"""Listening ports that stay the same over restarts of the task set, as long as nobody else takes them."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

from twisted.internet.error import CannotListenError
from twisted.internet.interfaces import IListeningPort
from twisted.logger import Logger

from rce.errors import Unavailable

log = Logger()


async def listen_again(listen: Callable[[int], Awaitable[int]], previous: int) -> int:
    """Listen on the port of last time, or on any free one if that is not possible.

    Args:
        listen: Listens on a port (0: any free one) and returns the port taken.
        previous: The port of last time; 0 if there is none.

    Raises:
        CannotListenError: The address cannot be used, from a `listen` of Twisted.
        Unavailable: The address cannot be used, from any other.
    """
    try:
        return await listen(previous)
    except (CannotListenError, Unavailable) as error:
        if not previous:
            raise
        reason = error
    port = await listen(0)
    log.info(
        "listening on port {port} instead of {previous}: {reason}", port=port, previous=previous, reason=str(reason)
    )
    return port


async def close_port(port: IListeningPort) -> None:
    """Stop listening; return when the port is free, which is not before the reactor's next turn."""
    closed = port.stopListening()  # type: ignore[misc]  # zope declares its methods without self
    if closed is not None:
        await closed.asFuture(asyncio.get_running_loop())
