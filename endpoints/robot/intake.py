"""Bounds on what one client sends: messages that wait for their conversion, and bad messages."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from rce.errors import NotConnected, RceError

BAD_WINDOW = 60.0  # seconds
MAX_CONVERSIONS = 16  # messages of one client that are not converted yet, above which no more are read
MAX_CONVERTED = 32 * 1024 * 1024  # bytes of these


class Conversions:
    """Messages of one client that are being converted; while they are too many, no more are read.

    Args:
        pause_reading: Stops reading from the client until a future is done.
    """

    def __init__(self, pause_reading: Callable[[asyncio.Future[None]], None]) -> None:
        self._pause_reading = pause_reading
        self._sizes: dict[asyncio.Task[None], int] = {}
        self._room: asyncio.Future[None] | None = None  # set while no more messages are read

    def add(self, task: asyncio.Task[None], size: int, then: Callable[[RceError | None], None]) -> None:
        """Await the conversion of a message of `size` bytes; `then` is called with its error, or None."""
        self._sizes[task] = size
        task.add_done_callback(lambda done: self._done(done, then))
        if self._room is None and not self._has_room():
            self._room = asyncio.get_running_loop().create_future()
            self._pause_reading(self._room)

    def _done(self, task: asyncio.Task[None], then: Callable[[RceError | None], None]) -> None:
        del self._sizes[task]
        if self._room is not None and self._has_room():
            self._room.set_result(None)
            self._room = None
        if task.cancelled():
            return
        error = task.exception()
        if error is not None and not isinstance(error, RceError):
            raise error
        then(error)

    def _has_room(self) -> bool:
        return len(self._sizes) < MAX_CONVERSIONS and sum(self._sizes.values()) < MAX_CONVERTED


class BadMessages:
    """Counter of bad messages, too many of which within a minute close the socket.

    Args:
        limit: Bad messages a minute; 0 for no limit.
        end: Closes the socket with a reason.
    """

    def __init__(self, limit: int, end: Callable[[str], None]) -> None:
        self._limit = limit
        self._end = end
        self._times: list[float] = []  # within BAD_WINDOW

    def count(self, error: RceError) -> None:
        """Count a message that was refused with this error."""
        if not self._limit or isinstance(error, NotConnected):  # the client cannot know that its peer has just gone
            return
        now = asyncio.get_running_loop().time()
        self._times.append(now)
        while self._times[0] < now - BAD_WINDOW:
            del self._times[0]
        if len(self._times) > self._limit:
            self._end(f"more than {self._limit} bad messages within a minute; the last: {error}")
