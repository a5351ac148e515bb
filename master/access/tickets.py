"""Tickets: one-time tokens for uploads and downloads, issued by a small request that was checked in full."""

from __future__ import annotations

import secrets
import time
from typing import Generic, TypeVar

T = TypeVar("T")


class Tickets(Generic[T]):
    """Tickets, each valid once and for `seconds`."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._open: dict[str, tuple[float, T]] = {}

    def issue(self, subject: T) -> str:
        """Issue a ticket for `subject`."""
        self._expire()
        token = secrets.token_urlsafe(32)
        self._open[token] = (time.monotonic() + self._seconds, subject)
        return token

    def take(self, token: str) -> T | None:
        """Redeem a ticket and return its subject, or None if it is not valid."""
        self._expire()
        _, subject = self._open.pop(token, (0, None))
        return subject

    def outstanding(self) -> list[T]:
        """Return the subjects of tickets that are still valid."""
        self._expire()
        return [subject for _, subject in self._open.values()]

    def _expire(self) -> None:
        now = time.monotonic()
        while self._open and (first := next(iter(self._open))) and self._open[first][0] < now:
            del self._open[first]
