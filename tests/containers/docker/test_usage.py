"""Resource usage of environments, from /proc and from Docker's statistics."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from containers.docker.usage import read
from containers.process.usage import used_below
from rce.control.calls.watching import EnvironmentUsage

BUSY = "import os, time\nwhile os.times().user < 0.1: pass\n"


def test_usage_of_a_process_tree_includes_ended_processes() -> None:
    inner = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {BUSY!r}]); print(flush=True); input()"
    child = subprocess.Popen([sys.executable, "-c", inner], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert child.stdout is not None
    child.stdout.readline()
    try:
        found = used_below([os.getpid(), child.pid, 2**30])
        assert set(found) == {os.getpid(), child.pid}
        assert found[child.pid].seconds >= 0.1
        assert found[os.getpid()].seconds >= found[child.pid].seconds
        assert found[os.getpid()].memory > found[child.pid].memory > 1_000_000
    finally:
        child.communicate()


@pytest.mark.parametrize("files", ["total_inactive_file", "inactive_file"])
def test_inactive_page_cache_is_not_counted(files: str) -> None:
    seen = {
        "cpu_stats": {"cpu_usage": {"total_usage": 2_500_000_000}},
        "memory_stats": {"usage": 5000, "stats": {files: 2000}},
    }
    assert read(seen) == EnvironmentUsage(2.5, 3000)


def test_ended_container_has_no_usage() -> None:
    assert read({"cpu_stats": {"cpu_usage": {"total_usage": 0}}, "memory_stats": {}}) is None
