"""Rate limit for received bytes: a token bucket.

The receiver enforces the limit, because it cannot rely on the sender to do so. While reading is paused, the flow
control of TCP and UNIX sockets stops the sender.
"""

from __future__ import annotations

import time
from collections.abc import Callable

BURST = 0.1  # seconds at the full rate that the bucket holds, so that small messages are not delayed
MIN_BURST = 16 * 1024  # bytes; with less, an environment with a low rate would be delayed at every message


class Throttle:
    """Token bucket.

    Args:
        rate: Bytes a second.
        clock: Source of the time in seconds.
    """

    def __init__(self, rate: int, clock: Callable[[], float] = time.monotonic) -> None:
        self._rate = rate
        self._capacity = max(MIN_BURST, rate * BURST)
        self._clock = clock
        self._tokens = self._capacity
        self._updated = clock()

    def consume(self, amount: int) -> float:
        """Account for `amount` received bytes; return the seconds to pause reading, 0 for none."""
        now = self._clock()
        self._tokens = min(self._capacity, self._tokens + (now - self._updated) * self._rate) - amount
        self._updated = now
        return max(0.0, -self._tokens / self._rate)
