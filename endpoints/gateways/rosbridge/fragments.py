"""Fragments of large operations, which a client sends one by one and in any order."""

from __future__ import annotations

from dataclasses import dataclass, field

from endpoints.gateways.rosbridge.operations import Fragment
from rce.errors import InvalidRequest, LimitExceeded

MAX_FRAGMENTED = 64  # operations of one client of which fragments are missing
MAX_FRAGMENTS = 100_000  # of one operation
MAX_AGE = 60.0  # seconds


@dataclass
class _Unfinished:
    total: int
    since: float
    size: int = 0
    parts: dict[int, str] = field(default_factory=dict)


class Fragments:
    """Fragments of one client.

    Args:
        limit: Characters that all fragments together may have.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._size = 0
        self._unfinished: dict[bytes, _Unfinished] = {}

    def add(self, fragment: Fragment, now: float) -> bytes | None:
        """Add a fragment; return the operation if it is complete.

        Raises:
            InvalidRequest: It does not fit to the others.
            LimitExceeded: Too much is unfinished; the operation is forgotten.
        """
        key = bytes(fragment.id)
        present = self._unfinished.get(key)
        if not 0 <= fragment.num < fragment.total or (present is not None and present.total != fragment.total):
            raise InvalidRequest(f"fragment {fragment.num} of {fragment.total} does not fit to the others of its id")
        if fragment.total > MAX_FRAGMENTS:
            raise LimitExceeded(f"an operation may have {MAX_FRAGMENTS} fragments at most, not {fragment.total}")
        if present is None:
            if len(self._unfinished) >= MAX_FRAGMENTED:
                raise LimitExceeded(f"{MAX_FRAGMENTED} operations are unfinished: send their fragments first")
            present = self._unfinished[key] = _Unfinished(fragment.total, now)
        if fragment.num in present.parts:
            raise InvalidRequest(f"fragment {fragment.num} came twice")
        present.parts[fragment.num] = fragment.data
        present.size += len(fragment.data)
        self._size += len(fragment.data)
        if self._size > self._limit:
            self._forget(key)
            raise LimitExceeded(f"fragments of unfinished operations have more than {self._limit} characters")
        if len(present.parts) < present.total:
            return None
        self._forget(key)
        return "".join(present.parts[number] for number in range(present.total)).encode()

    def sweep(self, now: float) -> None:
        """Forget operations whose fragments did not come in time."""
        for key in [key for key, each in self._unfinished.items() if each.since < now - MAX_AGE]:
            self._forget(key)

    def _forget(self, key: bytes) -> None:
        self._size -= self._unfinished.pop(key).size
