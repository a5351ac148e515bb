"""Where an environment is in its network group, and the others: a swarm chooses addresses and knows them by names."""

from __future__ import annotations

import socket
import time
from ipaddress import ip_address, ip_network

from msgspec.structs import replace

from endpoints.environment.settings import Settings
from rce.errors import StartFailed

PATIENCE = 5.0  # seconds for the names of members on other machines to be known here
PAUSE = 0.1


def settled(settings: Settings) -> Settings:
    """With addresses in the place of a subnet and of names. A member that is not known yet will know this one.

    StartFailed if this machine has no address in the subnet.
    """
    if "/" not in settings.address:
        return settings
    until = time.monotonic() + PATIENCE
    found: dict[str, str] = {}
    while lacking := [name for name in settings.peers if name not in found]:
        found |= {name: address for name in lacking if (address := _address_of(name))}
        if time.monotonic() > until:
            break
        time.sleep(PAUSE)
    return replace(settings, address=_own_address(settings.address), peers=list(found.values()))


def _own_address(subnet: str) -> str:
    addresses = socket.gethostbyname_ex(socket.gethostname())[2]
    inside = [address for address in addresses if ip_address(address) in ip_network(subnet)]
    if not inside:
        raise StartFailed(f"this environment has no address in the network {subnet} of its group: {addresses}")
    return inside[0]


def _address_of(name: str) -> str:
    """Empty if nobody knows it."""
    try:
        return socket.gethostbyname(name)
    except OSError:
        return ""
