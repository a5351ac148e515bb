"""Guessing passwords is slowed down: after some wrong ones each next try waits, twice as long as the one before.

Wrong passwords are counted for the user's name, whether there is such a user or not, and for the address that they come
from. Who has shown the right password at an address before is not kept out there by guesses from elsewhere. API keys
are not counted: 160 random bits are not guessed, and a robot with a good key always gets in.
"""

from __future__ import annotations

import ipaddress
import math
import time
from collections import OrderedDict
from collections.abc import Callable

from msgspec import Struct

from rce.errors import TooManyAttempts
from rce.names import MAX_TAG

FREE_OF_USER = 5  # wrong ones before the first wait
FREE_OF_ADDRESS = 20  # many may be behind one
LONGEST = 900.0  # seconds that one must wait at most
FORGET = 1800.0  # seconds without a wrong one after which all is forgotten
MOST = 10_000  # names and addresses that are remembered, each; the oldest go first


class _Count(Struct):
    wrong: int = 0
    last: float = 0.0
    free_at: float = 0.0


class _Counts:
    """Wrong tries by name."""

    def __init__(self, free: int, now: Callable[[], float]) -> None:
        self._free = free
        self._now = now
        self._counts: OrderedDict[str, _Count] = OrderedDict()

    def wait(self, name: str) -> float:
        """Seconds until the next try."""
        count = self._counts.get(name)
        return max(0.0, count.free_at - self._now()) if count else 0.0

    def wrong(self, name: str) -> None:
        now = self._now()
        count = self._counts.pop(name, None)
        if count is None or count.last < now - FORGET:
            count = _Count()
        count.wrong += 1
        count.last = now
        beyond = count.wrong - self._free
        count.free_at = now + min(LONGEST, 2.0 ** min(beyond, 20)) if beyond >= 0 else now
        self._counts[name] = count
        if len(self._counts) > MOST:
            self._counts.popitem(last=False)

    def __len__(self) -> int:
        return len(self._counts)


class Throttle:
    """`now` gives seconds."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._users = _Counts(FREE_OF_USER, now)
        self._addresses = _Counts(FREE_OF_ADDRESS, now)
        self._at_home = _Counts(FREE_OF_USER, now)  # of users, at addresses where they have shown the right one
        self._homes: OrderedDict[str, None] = OrderedDict()

    def check(self, user: str, address: str) -> None:
        """TooManyAttempts says how long to wait, and nothing of whether there is such a user."""
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
        place, home = _place(user, address)
        if home in self._homes:
            self._at_home.wrong(home)
        else:
            self._users.wrong(user[:MAX_TAG])
        if place:
            self._addresses.wrong(place)

    def right(self, user: str, address: str) -> None:
        """What was counted stays so: to know one password must not buy guesses at others."""
        _, home = _place(user, address)
        self._homes[home] = None
        self._homes.move_to_end(home)
        if len(self._homes) > MOST:
            self._homes.popitem(last=False)

    def __len__(self) -> int:
        return len(self._users) + len(self._addresses) + len(self._at_home) + len(self._homes)


def _place(user: str, address: str) -> tuple[str, str]:
    """The network that counts as one address, and its name with the user's."""
    place = network(address)
    return place, f"{user[:MAX_TAG]} {place}"


def network(address: str) -> str:
    """What counts as one address: of IPv6 the /64 of one customer. Empty for this machine, which may be a proxy."""
    try:
        ip = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return ""
    if isinstance(ip, ipaddress.IPv6Address):
        if ip.ipv4_mapped is None:
            return "" if ip.is_loopback else str(ipaddress.ip_network((ip, 64), strict=False))
        ip = ip.ipv4_mapped
    return "" if ip.is_loopback else str(ip)
