"""Memory of processes that allocate large messages again and again.

By default malloc returns large blocks to the system at once, and the page faults of the next allocation take several
times as long as copying the message. A WebSocket echo of 10 MB takes 29 ms by default and 18 ms with these thresholds;
through ROS 2 and back, 55 ms and 15 ms.
"""

from __future__ import annotations

import ctypes

MB = 1024 * 1024
MMAP_THRESHOLD, TRIM_THRESHOLD = 32 * MB, 128 * MB
M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # malloc.h
VARIABLES = {  # environment variables with the same effect on a child process
    "MALLOC_MMAP_THRESHOLD_": str(MMAP_THRESHOLD),
    "MALLOC_TRIM_THRESHOLD_": str(TRIM_THRESHOLD),
}


def keep_large_blocks() -> None:
    """Make malloc keep freed blocks of up to `MMAP_THRESHOLD` for reuse in this process; no effect without glibc."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, MMAP_THRESHOLD)
        mallopt(M_TRIM_THRESHOLD, TRIM_THRESHOLD)


_new_bytearray = ctypes.pythonapi.PyByteArray_FromStringAndSize
_new_bytearray.restype = ctypes.py_object
_new_bytearray.argtypes = (ctypes.c_char_p, ctypes.c_ssize_t)


def uninitialized(size: int) -> bytearray:
    """Return a buffer with undefined content: never pass it on before all of it is written.

    `bytearray(size)` writes zeros, and all of its pages take memory at once. Those of this one take memory when they
    are written.
    """
    buffer: bytearray = _new_bytearray(None, size)
    return buffer
