"""How fast what comes in is taken: a token bucket on the receiving side, since what a sender promises can be broken.

The bucket holds a tenth of a second's worth, so that small messages do not wait. TCP and UNIX sockets make the sender
wait for the rest.
"""

from __future__ import annotations

import time
from collections.abc import Callable

BURST = 0.1  # seconds
LEAST = 16 * 1024  # bytes; with less a slow environment would wait for every message


class Throttle:
    """`rate` is in bytes a second."""

    def __init__(self, rate: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = rate
        self._most = max(LEAST, rate * BURST)
        self._clock = clock
        self._left = self._most
        self._at = clock()

    def take(self, amount: int) -> float:
        """Account for bytes that have come in; returns the seconds until more may."""
        now = self._clock()
        self._left = min(self._most, self._left + (now - self._at) * self._rate) - amount
        self._at = now
        return max(0.0, -self._left / self._rate)
