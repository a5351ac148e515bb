"""Buffers for large messages."""

from __future__ import annotations

import ctypes

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
