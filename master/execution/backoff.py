"""Exponential back-off for what fails again and again."""

from __future__ import annotations

import asyncio
from typing import NamedTuple

MAX_FAILURES = 1000  # failures that are remembered, beyond those that still count


class _Failure(NamedTuple):
    when: float
    pause: float


class Backoff:
    """Pauses before retries: each failure in a row doubles the pause, from none over `first` to `most` seconds.

    What worked for `steady` seconds begins anew.
    """

    def __init__(self, first: float, most: float, steady: float) -> None:
        self._first = first
        self._most = most
        self._steady = steady
        self._failures: dict[str, _Failure] = {}

    def after_failure(self, key: str) -> float:
        """Return the seconds to wait after this failure of `key`."""
        now = asyncio.get_running_loop().time()
        last = self._failures.pop(key, None)
        in_a_row = last is not None and now - last.when - last.pause < self._steady
        pause = min(max(2 * last.pause, self._first), self._most) if last and in_a_row else 0.0
        if len(self._failures) > MAX_FAILURES:
            self._forget(now)
        self._failures[key] = _Failure(now, pause)
        return pause

    def _forget(self, now: float) -> None:
        self._failures = {
            key: failure for key, failure in self._failures.items() if now - failure.when - failure.pause < self._steady
        }
