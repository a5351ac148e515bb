"""The message of a publisher that does not wait, until it can be sent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

from rce.protocol.blobs import Buffer

Offline = Literal["drop", "newest", "store"]
"""Treatment of messages that cannot be sent: drop them, keep the newest one, or store them in their order."""


class Encoded(NamedTuple):
    """A message as frames."""

    text: bytes
    blobs: Mapping[str, Buffer]


class Backlog:
    """The newest message, before which the one before it gives way.

    Attributes:
        keep: True if a message is kept while it cannot be sent.
        dropped: Number of messages that were dropped.
    """

    def __init__(self, *, keep: bool) -> None:
        """Create an empty backlog; `keep` says whether a message is kept while it cannot be sent."""
        self.dropped = 0
        self.keep = keep
        self._message: Encoded | None = None
        self._until = math.inf

    def __bool__(self) -> bool:
        return self._message is not None

    def put(self, message: Encoded, possible: bool, until: float = math.inf) -> None:
        """Add a message.

        Args:
            message: The message.
            possible: Whether it can be sent now.
            until: Time until which it is of use; see `drop_old`.
        """
        if not possible and not self.keep:
            self.dropped += 1
            return
        self.dropped += self._message is not None
        self._message, self._until = message, until

    def drop_old(self, now: float) -> None:
        """Drop a message that is of no use any more."""
        if self._message is not None and self._until < now:
            self._drop()

    def first(self) -> Encoded | None:
        """Return the message, which stays until it is removed."""
        return self._message

    def remove(self, message: Encoded) -> None:
        """Remove this message, if it is still there."""
        if self._message is message:
            self._message = None

    def disconnected(self) -> None:
        """Drop what the publisher does not keep while it is offline."""
        if not self.keep and self._message is not None:
            self._drop()

    def _drop(self) -> None:
        self._message = None
        self.dropped += 1
