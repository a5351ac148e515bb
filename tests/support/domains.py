"""ROS domains for tests that start programs of ROS 2 themselves, exclusive on this machine."""

from __future__ import annotations

from functools import cache

from containers.process.domains import Domains


@cache
def domain(purpose: str) -> int:
    """Return a domain for a purpose, which is held until this process ends."""
    number, _ = Domains().take()
    return number
