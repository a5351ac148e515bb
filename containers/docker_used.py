"""What a container has used, as Docker tells it in either version of control groups."""

from __future__ import annotations

from typing import Any

import docker
from docker.errors import NotFound

from rce.calls.watching import Used

NANO = 1e9


def used(api: docker.APIClient, container: str) -> Used | None:
    """None of one that is gone, or has not begun. Memory is without files that can be dropped, as Docker shows it."""
    try:
        seen: dict[str, Any] = api.stats(container, stream=False, one_shot=True)
    except NotFound:
        return None
    return read(seen)


def read(seen: dict[str, Any]) -> Used | None:
    """From Docker's `/containers/…/stats`."""
    memory = seen.get("memory_stats", {})
    if "usage" not in memory:
        return None
    kinds = memory.get("stats", {})
    files = kinds.get("total_inactive_file", kinds.get("inactive_file", 0))  # version 1 has both, the first of the tree
    return Used(seen["cpu_stats"]["cpu_usage"]["total_usage"] / NANO, max(0, memory["usage"] - files))
