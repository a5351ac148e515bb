"""Fair queue: users take turns, however many jobs each of them has."""

from __future__ import annotations

from collections import Counter, deque


class FairQueue:
    """Jobs by user. The least recently served user is next; the jobs of one user stay in order."""

    def __init__(self, per_user: int) -> None:
        self._per_user = per_user
        self._waiting: dict[str, deque[str]] = {}
        self._turns: list[str] = []  # users, the least recently served first

    def push(self, user: str, job: str, *, first: bool = False) -> None:
        """Add a job; with `first`, before the other jobs of its user."""
        waiting = self._waiting.setdefault(user, deque())
        if first:
            waiting.appendleft(job)
        else:
            waiting.append(job)
        if user not in self._turns:
            self._turns.insert(0, user)

    def pop(self, running: Counter[str]) -> str | None:
        """Remove and return the next job of a user with fewer than `per_user` running jobs; None if there is none."""
        for user in self._turns:
            if self._waiting.get(user) and running[user] < self._per_user:
                self._turns.remove(user)
                self._turns.append(user)
                return self._waiting[user].popleft()
        return None

    def remove(self, user: str, job: str) -> bool:
        """Remove a job; return False if it is not in the queue."""
        try:
            self._waiting.get(user, deque()).remove(job)
        except ValueError:
            return False
        return True

    def ahead(self, user: str, job: str) -> int:
        """Return the number of jobs of the same user before this one."""
        waiting = self._waiting.get(user, deque())
        return waiting.index(job) if job in waiting else 0

    def count(self, user: str) -> int:
        """Return the number of waiting jobs of a user."""
        return len(self._waiting.get(user, ()))
