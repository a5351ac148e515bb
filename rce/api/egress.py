"""Egress of environments: what they may reach beside their group, as one text.

`none`; `internet`, without private and link-local networks, metadata services of clouds, and the host; `all`; or a list
of addresses with ports, as `10.0.0.5:5432,192.0.2.0/28:443`, of which only TCP is let through. Addresses, not names:
the rules of packet filters have addresses, and queries for names would carry data to anybody.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

_OCTET = r"(25[0-5]|2[0-4][0-9]|1[0-9][0-9]|[1-9]?[0-9])"
_PORT = r"(6553[0-5]|655[0-2][0-9]|65[0-4][0-9]{2}|6[0-4][0-9]{3}|[1-5][0-9]{4}|[1-9][0-9]{0,3})"
_HOST = rf"({_OCTET}\.){{3}}{_OCTET}(/(3[0-2]|[12]?[0-9]))?:{_PORT}"
PATTERN = rf"^(none|internet|all|{_HOST}(,{_HOST}){{0,99}})$(?!\n)"
WORDS = "none, internet, all, or IPv4 addresses with ports and commas between, as 10.0.0.5:5432,192.0.2.0/28:443"

Egress = Annotated[str, Meta(pattern=PATTERN)]


def targets(egress: str) -> list[tuple[str, str]]:
    """Return the addresses and ports that a list allows; none if the egress is no list."""
    if egress in ("none", "internet", "all"):
        return []
    return [(host, port) for host, _, port in (each.rpartition(":") for each in egress.split(","))]
