"""Throttle of wrong passwords: after some, each further attempt must wait twice as long as the one before.

Wrong passwords are counted by user name, whether the user exists or not, and by address. A user who once gave the right
password from an address is not locked out there by attempts from elsewhere. API keys are not counted: 160 random bits
cannot be guessed, and a robot with a valid key must always get in.
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict
from collections.abc import Callable

from msgspec import Struct

from rce.errors import TooManyAttempts
from rce.net.pending_logins import network
from rce.protocol.names import MAX_TAG

FREE_BY_USER = 5  # wrong passwords before the first wait
FREE_BY_ADDRESS = 20  # many users may share one
MAX_WAIT = 900.0  # seconds
FORGET_AFTER = 1800.0  # seconds without a wrong password
MAX_REMEMBERED = 10_000  # names, and addresses; the oldest are dropped


class _Count(Struct):
    wrong: int = 0
    last: float = 0.0
    free_at: float = 0.0


class _Counts:
    """Wrong attempts by name."""

    def __init__(self, free: int, now: Callable[[], float]) -> None:
        self._free = free
        self._now = now
        self._counts: OrderedDict[str, _Count] = OrderedDict()

    def wait(self, name: str) -> float:
        """Return the seconds until the next attempt is allowed."""
        count = self._counts.get(name)
        return max(0.0, count.free_at - self._now()) if count else 0.0

    def wrong(self, name: str) -> None:
        """Count a wrong attempt."""
        now = self._now()
        count = self._counts.pop(name, None)
        if count is None or count.last < now - FORGET_AFTER:
            count = _Count()
        count.wrong += 1
        count.last = now
        beyond = count.wrong - self._free
        count.free_at = now + min(MAX_WAIT, 2.0 ** min(beyond, 20)) if beyond >= 0 else now
        self._counts[name] = count
        if len(self._counts) > MAX_REMEMBERED:
            self._counts.popitem(last=False)

    def __len__(self) -> int:
        return len(self._counts)


class Throttle:
    """Throttle by user and address; `now` returns seconds."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._users = _Counts(FREE_BY_USER, now)
        self._addresses = _Counts(FREE_BY_ADDRESS, now)
        self._at_home = _Counts(FREE_BY_USER, now)  # of users at addresses from which they once logged in
        self._homes: OrderedDict[str, None] = OrderedDict()

    def check(self, user: str, address: str) -> None:
        """Check that an attempt is allowed now.

        Raises:
            TooManyAttempts: It is not; the error says how long to wait, not whether the user exists.
        """
        place, home = _place(user, address)
        waits = [self._at_home.wait(home) if home in self._homes else self._users.wait(user[:MAX_TAG])]
        if place:
            waits.append(self._addresses.wait(place))
        seconds = math.ceil(max(waits))
        if seconds:
            raise TooManyAttempts(
                f"too many wrong passwords for this user or from this address: try again in {seconds} s",
                retry_after=seconds,
            )

    def wrong(self, user: str, address: str) -> None:
        """Count a wrong password."""
        place, home = _place(user, address)
        if home in self._homes:
            self._at_home.wrong(home)
        else:
            self._users.wrong(user[:MAX_TAG])
        if place:
            self._addresses.wrong(place)

    def right(self, user: str, address: str) -> None:
        """Note a right password. Counts stay: knowing one password must not allow guesses at others."""
        _, home = _place(user, address)
        self._homes[home] = None
        self._homes.move_to_end(home)
        if len(self._homes) > MAX_REMEMBERED:
            self._homes.popitem(last=False)

    def __len__(self) -> int:
        return len(self._users) + len(self._addresses) + len(self._at_home) + len(self._homes)


def _place(user: str, address: str) -> tuple[str, str]:
    """Return the network that counts as one address, and a name for the user at it."""
    place = network(address)
    return place, f"{user[:MAX_TAG]} {place}"
