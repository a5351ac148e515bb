"""Hosts file of an environment in a network group, which the agent of its node keeps up to date."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from ipaddress import ip_address, ip_network


def hosts(text: str, subnet: str, members: Mapping[str, str]) -> str:
    """Return a hosts file with the members of a group first, and no other addresses of its subnet."""
    network = ip_network(subnet)
    lines = [line for line in text.splitlines() if not _is_within(line, network.__contains__)]
    return "".join(f"{line}\n" for line in [*(f"{members[tag]}\t{tag}" for tag in sorted(members)), *lines])


def _is_within(line: str, contains: Callable[[object], bool]) -> bool:
    address = line.split(maxsplit=1)[:1]
    try:
        return bool(address) and contains(ip_address(address[0]))
    except ValueError:
        return False
