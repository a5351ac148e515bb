"""Memory of large messages is kept for the next ones; other processes return what they free."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from rce.process.malloc import VARIABLES

ROUNDS, BLOCKS, SIZE = 5, 3, 20_000_000
PAGES = BLOCKS * SIZE // os.sysconf("SC_PAGE_SIZE")  # of the blocks that are in use at a time
PAGE_FAULTS = f"""
import resource
from rce.process.malloc import keep_large_blocks
{{start}}
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
def handle():
    return [b"x" * {SIZE} for _ in range({BLOCKS})]
handle()
before = faults()
for _ in range({ROUNDS}):
    handle()
print(faults() - before)
"""

GROWTH = f"""
from rce.process.malloc import return_freed_memory
{{start}}
def memory():
    fields = open("/proc/self/smaps_rollup").read().split()
    return 1024 * int(fields[fields.index("Anonymous:") + 1])
def peak():
    b"x" * {SIZE}
    return [bytes(4000) for _ in range({SIZE // 4000})]
before = memory()
peak()
print(memory() - before)
"""


def run_program(text: str, **variables: str) -> int:
    """Return the number that a Python program prints."""
    command = [sys.executable, "-P", "-c", text]
    return int(subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=True).stdout)


def page_faults(start: str = "", **variables: str) -> int:
    """Return the number of page faults of a process that allocates and frees large blocks several times."""
    return run_program(PAGE_FAULTS.format(start=start), **variables)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_memory_of_freed_blocks_is_used_again() -> None:
    assert page_faults() > ROUNDS * PAGES / 2, "by default the system gives new pages each time"
    assert page_faults("keep_large_blocks()") < PAGES / 2
    assert page_faults(**VARIABLES) < PAGES / 2, "the variables have the same effect on a child process"


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_freed_memory_goes_back_to_the_system() -> None:
    assert run_program(GROWTH.format(start="")) > SIZE / 2, "a large block that was freed has raised the thresholds"
    assert run_program(GROWTH.format(start="return_freed_memory()")) < SIZE / 10
