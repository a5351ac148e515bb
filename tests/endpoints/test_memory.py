"""Memory of large messages: it is kept for the next ones, and taken when it is written."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from endpoints.memory import VARIABLES, uninitialized

ROUNDS, BLOCKS, SIZE = 5, 3, 20_000_000
PAGES = BLOCKS * SIZE // os.sysconf("SC_PAGE_SIZE")  # of the blocks that are in use at a time
PROGRAM = f"""
import resource
from endpoints.memory import keep_large_blocks
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


def page_faults(start: str = "", **variables: str) -> int:
    """Return the number of page faults of a process that allocates and frees large blocks several times."""
    done = subprocess.run(
        [sys.executable, "-P", "-c", PROGRAM.format(start=start)],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_memory_of_freed_blocks_is_used_again() -> None:
    assert page_faults() > ROUNDS * PAGES / 2, "by default the system gives new pages each time"
    assert page_faults("keep_large_blocks()") < PAGES / 2
    assert page_faults(**VARIABLES) < PAGES / 2, "the variables have the same effect on a child process"


def test_uninitialized_buffer_has_its_size_and_can_be_written() -> None:
    buffer = uninitialized(10)
    buffer[:] = b"0123456789"
    assert buffer == b"0123456789"
    assert uninitialized(0) == b""
