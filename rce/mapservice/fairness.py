"""Whose turn it is: users take turns, whatever number of jobs each has waiting."""

from __future__ import annotations

from collections import Counter, deque


class FairQueue:
    """Jobs of users, in each user's order. The user who was served longest ago is served next."""

    def __init__(self, per_user: int) -> None:
        self._per_user = per_user
        self._waiting: dict[str, deque[str]] = {}
        self._turns: list[str] = []  # users, the one served last at the end

    def push(self, user: str, job: str, *, first: bool = False) -> None:
        waiting = self._waiting.setdefault(user, deque())
        if first:
            waiting.appendleft(job)
        else:
            waiting.append(job)
        if user not in self._turns:
            self._turns.insert(0, user)

    def pop(self, running: Counter[str]) -> str | None:
        """The next job, of a user who has fewer than `per_user` running; None if there is none."""
        for user in self._turns:
            if self._waiting.get(user) and running[user] < self._per_user:
                self._turns.remove(user)
                self._turns.append(user)
                return self._waiting[user].popleft()
        return None

    def remove(self, user: str, job: str) -> bool:
        """Take a job out; whether it was there."""
        try:
            self._waiting.get(user, deque()).remove(job)
        except ValueError:
            return False
        return True

    def ahead(self, user: str, job: str) -> int:
        """How many jobs of the same user come before this one."""
        waiting = self._waiting.get(user, deque())
        return waiting.index(job) if job in waiting else 0

    def count(self, user: str) -> int:
        return len(self._waiting.get(user, ()))
