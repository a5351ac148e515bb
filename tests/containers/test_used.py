"""What environments use, as /proc and Docker tell it."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from containers.docker_used import read
from containers.processes_used import used_below
from rce.calls.watching import Used

BUSY = "import os, time\nwhile os.times().user < 0.1: pass\n"


def test_a_tree_of_processes_is_one_sum_with_those_that_have_ended() -> None:
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
def test_files_in_memory_that_can_be_dropped_do_not_count(files: str) -> None:
    seen = {
        "cpu_stats": {"cpu_usage": {"total_usage": 2_500_000_000}},
        "memory_stats": {"usage": 5000, "stats": {files: 2000}},
    }
    assert read(seen) == Used(2.5, 3000)


def test_a_container_that_has_ended_has_no_figures() -> None:
    assert read({"cpu_stats": {"cpu_usage": {"total_usage": 0}}, "memory_stats": {}}) is None
