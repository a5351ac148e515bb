"""One-time tokens for what a large body is about, handed out beforehand by a small request that was checked in full."""

from __future__ import annotations

import secrets
import time
from typing import Generic, TypeVar

T = TypeVar("T")


class Tickets(Generic[T]):
    """Each is good once, and for `seconds`."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._open: dict[str, tuple[float, T]] = {}

    def issue(self, subject: T) -> str:
        self._expire()
        token = secrets.token_urlsafe(32)
        self._open[token] = (time.monotonic() + self._seconds, subject)
        return token

    def take(self, token: str) -> T | None:
        """What the token is for; None if it is none, or not any more."""
        self._expire()
        _, subject = self._open.pop(token, (0, None))
        return subject

    def outstanding(self) -> list[T]:
        self._expire()
        return [subject for _, subject in self._open.values()]

    def _expire(self) -> None:
        now = time.monotonic()
        while self._open and (first := next(iter(self._open))) and self._open[first][0] < now:
            del self._open[first]
