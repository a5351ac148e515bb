"""Order and pace of key frames: in order, a few ahead of the answers, not faster than the line should carry."""

from __future__ import annotations

from collections.abc import Iterator

from rce.mapping3d.offload.messages import FORMAT, encode
from rce.mapping3d.offload.outbox import Outbox

WINDOW = 4  # key frames that may be unanswered
PATIENCE = 5.0  # seconds without an answer after which those are sent again
BURST = 0.1  # seconds for which the line may be used in advance
RATE = 400_000.0  # bytes per second, after a pause of the line too


class Sending:
    """State of one line. Key frames stay in the outbox until they are answered, so that none is lost.

    Attributes:
        sent: Bytes that were sent, repetitions included.
    """

    def __init__(self, rate: float = RATE) -> None:
        """Begin.

        Args:
            rate: Bytes per second that are not exceeded.
        """
        self.sent = 0
        self._rate = rate
        self._unanswered: dict[int, int] = {}  # by stamp in microseconds: the index
        self._last = -1  # index of the key frame that was sent last
        self._heard = 0.0  # when something was answered, or sent anew
        self._free = 0.0  # when the line has carried what was sent

    def due(self, outbox: Outbox, now: float) -> Iterator[tuple[float, str, bytes]]:
        """Yield stamp, format and bytes of what is to be sent at a time, seconds of any clock."""
        if self._unanswered and now - self._heard > PATIENCE:
            self.restart()
        while len(self._unanswered) < WINDOW and self._free <= now + BURST:
            message = outbox.after(self._last)
            if message is None:
                return
            if not self._unanswered:
                self._heard = now
            data = encode(message)
            self._last = message.index
            self._unanswered[round(message.stamp * 1e6)] = message.index
            self._free = max(self._free, now) + len(data) / self._rate
            self.sent += len(data)
            yield message.stamp, FORMAT, data

    def answered(self, outbox: Outbox, stamp: int, now: float) -> None:
        """Take note that the cloud has the key frame of a stamp, microseconds."""
        index = self._unanswered.pop(stamp, None)
        if index is not None:
            outbox.acknowledge(index)
            self._heard = now

    def restart(self) -> None:
        """Send all that was not answered again: the line was cut."""
        self._unanswered.clear()
        self._last = -1
