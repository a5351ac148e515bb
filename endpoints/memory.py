"""How malloc treats the blocks of large messages, which are allocated anew each time.

By default it gives them back to the system at once, and the page faults of the next ones take several times as long as
the copying: a bare WebSocket echo of 10 MB takes 29 ms, with these thresholds 18; through ROS 2 and back 55, with these
15.
"""

from __future__ import annotations

import ctypes

MB = 1024 * 1024
MMAP_THRESHOLD, TRIM_THRESHOLD = 32 * MB, 128 * MB
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h
VARIABLES = {  # the same for a process that we start
    "MALLOC_MMAP_THRESHOLD_": str(MMAP_THRESHOLD),
    "MALLOC_TRIM_THRESHOLD_": str(TRIM_THRESHOLD),
}


def keep_large_blocks() -> None:
    """Have this process keep freed blocks of up to `MMAP_THRESHOLD` for the next message. Without glibc: nothing."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, MMAP_THRESHOLD)
        mallopt(M_TRIM_THRESHOLD, TRIM_THRESHOLD)
