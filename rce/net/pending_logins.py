"""Connections of clients that have not logged in, counted by address.

Anyone may connect, say nothing, and so keep a file descriptor and memory. A connection therefore counts for its address
until its client has logged in, and an address may have a certain number of these.
"""

from __future__ import annotations

import ipaddress
import logging
import time
from collections import Counter
from collections.abc import Callable
from functools import lru_cache

MAX_PENDING = 500  # connections of one address; a site may have many robots behind one
WARNING_INTERVAL = 60.0  # seconds between warnings

log = logging.getLogger(__name__)


class PendingLogin:
    """A connection that counts for its address until `end`.

    Attributes:
        place: What counts as one address; empty for this machine.
    """

    def __init__(self, counts: Counter[str], place: str) -> None:
        self.place = place
        self._counts = counts
        self._counted = bool(place)
        if place:
            counts[place] += 1

    def end(self) -> None:
        """Count it no longer: the client has logged in, or the connection is closed. Again has no effect."""
        if self._counted:
            self._counted = False
            self._counts[self.place] -= 1
            if not self._counts[self.place]:
                del self._counts[self.place]


class PendingLogins:
    """The connections that have not logged in, counted by address. This machine, which may be a proxy, has no bound."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._next_warning = 0.0
        self._counts: Counter[str] = Counter()

    def begin(self, address: str) -> PendingLogin | None:
        """Count a connection; return None if its address has too many."""
        place = network(address)
        if not place or self._counts[place] < MAX_PENDING:
            return PendingLogin(self._counts, place)
        if self._now() >= self._next_warning:
            self._next_warning = self._now() + WARNING_INTERVAL
            log.warning("%s has %d connections without a login: further ones are refused", place, MAX_PENDING)
        return None

    def __len__(self) -> int:
        return sum(self._counts.values())


@lru_cache(maxsize=1024)
def network(address: str) -> str:
    """Return what counts as one address: for IPv6 a /64. Empty for this machine, which may be a proxy."""
    try:
        ip = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return ""
    if isinstance(ip, ipaddress.IPv6Address):
        if ip.ipv4_mapped is None:
            return "" if ip.is_loopback else str(ipaddress.ip_network((ip, 64), strict=False))
        ip = ip.ipv4_mapped
    return "" if ip.is_loopback else str(ip)
