"""Resource usage of containers, from Docker's statistics."""

from __future__ import annotations

import pytest

from containers.docker.usage import read
from rce.control.calls.watching import EnvironmentUsage


@pytest.mark.parametrize("files", ["total_inactive_file", "inactive_file"])
def test_inactive_page_cache_is_not_counted(files: str) -> None:
    seen = {
        "cpu_stats": {"cpu_usage": {"total_usage": 2_500_000_000}},
        "memory_stats": {"usage": 5000, "stats": {files: 2000}},
    }
    assert read(seen) == EnvironmentUsage(2.5, 3000)


def test_ended_container_has_no_usage() -> None:
    assert read({"cpu_stats": {"cpu_usage": {"total_usage": 0}}, "memory_stats": {}}) is None


def test_child_groups_count_under_cgroup_v1() -> None:
    """Version 1 has both numbers; that of all child groups is the one that `usage` includes."""
    kinds = {"total_inactive_file": 3000, "inactive_file": 1000}
    seen = {"cpu_stats": {"cpu_usage": {"total_usage": 0}}, "memory_stats": {"usage": 5000, "stats": kinds}}
    assert read(seen) == EnvironmentUsage(0.0, 2000)


def test_memory_is_never_negative() -> None:
    seen = {
        "cpu_stats": {"cpu_usage": {"total_usage": 0}},
        "memory_stats": {"usage": 1000, "stats": {"inactive_file": 1001}},
    }
    assert read(seen) == EnvironmentUsage(0.0, 0)
