"""Limits of what a joined process may send, by its role.

Programs in an environment may use the credential of its endpoint. So an environment has limits that no sound endpoint
reaches, and all environments of a user share one budget of calls.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from weakref import WeakValueDictionary

from rce.control.calls.joining import Hello

MAX_ENVIRONMENT_MESSAGE = 1024 * 1024  # bytes
MAX_MESSAGE = 64 * 1024 * 1024  # bytes, of all other roles
MAX_ITEMS = 300  # strings, numbers and lists of a message: a call has 10 and its pages
CALLS_PER_SECOND = 100  # of all environments of a user, and for each of them
CALLS_PER_CONNECTION = 0.5  # more a second
BURST = 500  # calls
BYTES_PER_CALL = 10_000  # a larger call counts as several
JOIN = 2  # calls that a join counts as
MAX_JOINED = 10_000  # environments whose first join is remembered


class Budget:
    """Budget of calls, which several connections share.

    Attributes:
        connections: Number of the connections.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self.connections = 0
        self._now = now
        self._used = 0.0  # calls that count at present
        self._joined: dict[str, None] = {}  # environments; the one that joined first is the first to be forgotten
        self._since = now()

    def use(self, calls: float) -> float:
        """Count calls; return the seconds to wait before the next one."""
        now, rate = self._now(), CALLS_PER_SECOND + CALLS_PER_CONNECTION * self.connections
        self._used = max(0.0, self._used - (now - self._since) * rate) + calls
        self._since = now
        return max(0.0, (self._used - BURST) / rate)

    def join(self, environment: str) -> float:
        """Count a join of an environment; return the seconds to wait before it is answered.

        The first is free: after a restart of the Master all environments of a user return at once.
        """
        if environment in self._joined:
            return self.use(JOIN)
        self._joined[environment] = None
        if len(self._joined) > MAX_JOINED:
            del self._joined[next(iter(self._joined))]
        return 0.0


class Budgets:
    """Budgets by user, while a connection has them."""

    def __init__(self) -> None:
        self._by_user: WeakValueDictionary[str, Budget] = WeakValueDictionary()

    def of(self, hello: Hello) -> Budget | None:
        """Return the budget of a process that was admitted; None for no limit."""
        if hello.role != "environment":
            return None
        user = hello.name.partition("/")[0]
        budget = self._by_user.get(user)
        if budget is None:
            budget = self._by_user[user] = Budget()
        return budget


def max_message(role: str) -> int:
    """Return the limit of the size of a process's messages."""
    return MAX_ENVIRONMENT_MESSAGE if role == "environment" else MAX_MESSAGE
