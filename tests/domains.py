"""ROS domains for tests that start programs of ROS 2 themselves: nobody else on this machine has them meanwhile."""

from __future__ import annotations

from functools import cache

from containers.domains import Domains


@cache
def domain(purpose: str) -> int:
    """One for each purpose; held until this process ends."""
    number, _ = Domains().take()
    return number
