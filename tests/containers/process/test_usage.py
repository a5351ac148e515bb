"""Resource usage of process trees, from /proc."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from containers.process import usage
from containers.process.usage import used_below

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


def test_program_name_with_blanks_and_brackets_is_parsed() -> None:
    text = "7 (a) b (c) S 3 " + " ".join(map(str, range(100, 150)))
    process, parent = usage._parse(7, text)
    assert (process.pid, parent) == (7, 3)
    ticks = sum(range(109, 113))  # utime, stime, cutime and cstime
    assert process.seconds == ticks / os.sysconf("SC_CLK_TCK")
    assert process.memory == 119 * os.sysconf("SC_PAGE_SIZE")


def test_process_that_ends_meanwhile_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [*os.listdir("/proc"), str(2**30)]
    monkeypatch.setattr(os, "listdir", lambda path: entries)
    assert set(used_below([os.getpid(), 2**30])) == {os.getpid()}
