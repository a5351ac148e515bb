"""Resource usage of a container from Docker's statistics, for both versions of control groups."""

from __future__ import annotations

from typing import Any

import docker
from docker.errors import NotFound

from rce.control.calls.watching import EnvironmentUsage

NANO = 1e9


def used(api: docker.APIClient, container: str) -> EnvironmentUsage | None:
    """Return the usage of a container; None if it does not exist or has not started.

    Memory excludes inactive page cache, as in `docker stats`.
    """
    try:
        seen: dict[str, Any] = api.stats(container, stream=False, one_shot=True)
    except NotFound:
        return None
    return read(seen)


def read(seen: dict[str, Any]) -> EnvironmentUsage | None:
    """Convert the answer of Docker's `/containers/{id}/stats`; None if the container does not run."""
    memory = seen.get("memory_stats", {})
    if "usage" not in memory:
        return None
    kinds = memory.get("stats", {})
    files = kinds.get(
        "total_inactive_file", kinds.get("inactive_file", 0)
    )  # version 1 has both; total_ includes child groups
    return EnvironmentUsage(seen["cpu_stats"]["cpu_usage"]["total_usage"] / NANO, max(0, memory["usage"] - files))
