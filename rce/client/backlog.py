"""Messages of a publisher that does not wait, until they can be sent."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Literal, NamedTuple, get_args

from rce.errors import InvalidRequest
from rce.protocol.blobs import Buffer

Offline = Literal["drop", "newest", "store"]
"""Treatment of messages that cannot be sent: drop them, keep the newest one, or store them in their order."""

MOST_MESSAGES, MOST_BYTES = 10_000, 64 << 20  # that are stored


class Encoded(NamedTuple):
    """A message as frames."""

    text: bytes
    blobs: Mapping[str, Buffer]

    @property
    def size(self) -> int:
        """Number of bytes."""
        return len(self.text) + sum(map(len, self.blobs.values()))


class Backlog:
    """Queue of messages, of which the oldest give way.

    Attributes:
        dropped: Number of messages that were dropped.

    Raises:
        InvalidRequest: `offline` is none of the choices.
    """

    def __init__(self, offline: Offline) -> None:
        if offline not in get_args(Offline):
            raise InvalidRequest(f"offline={offline!r}: write {', '.join(get_args(Offline))}", field="offline")
        self.offline = offline
        self.dropped = 0
        self._messages: deque[tuple[Encoded, float]] = deque()  # each with the time until which it is of use
        self._bytes = 0
        self._most = MOST_MESSAGES if offline == "store" else 1

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, message: Encoded, possible: bool, until: float = math.inf) -> None:
        """Add a message.

        Args:
            message: The message.
            possible: Whether it can be sent now.
            until: Time until which it is of use; see `drop_old`.
        """
        if self.offline == "drop" and not possible:
            self.dropped += 1
            return
        self._messages.append((message, until))
        self._bytes += message.size
        while len(self._messages) > self._most or (self._bytes > MOST_BYTES and len(self._messages) > 1):
            self._drop_first()

    def drop_old(self, now: float) -> None:
        """Drop the messages that are of no use any more."""
        while self._messages and self._messages[0][1] < now:
            self._drop_first()

    def _drop_first(self) -> None:
        self.remove(self._messages[0][0])
        self.dropped += 1

    def first(self) -> Encoded | None:
        """Return the oldest message, which stays until it is removed."""
        return self._messages[0][0] if self._messages else None

    def remove(self, message: Encoded) -> None:
        """Remove the oldest message, if it is this one."""
        if self._messages and self._messages[0][0] is message:
            self._messages.popleft()
            self._bytes -= message.size

    def disconnected(self) -> None:
        """Drop what the publisher does not keep while it is offline."""
        if self.offline == "drop":
            self.dropped += len(self._messages)
            self._messages.clear()
            self._bytes = 0
