"""Buffers for large messages."""

from __future__ import annotations

import ctypes

_WRITABLE = 0x200  # PyBUF_WRITE
_new_bytes = ctypes.pythonapi.PyBytes_FromStringAndSize
_new_bytes.restype = ctypes.py_object
_new_bytes.argtypes = (ctypes.c_char_p, ctypes.c_ssize_t)
_address_of = ctypes.pythonapi.PyBytes_AsString
_address_of.restype = ctypes.c_void_p
_address_of.argtypes = (ctypes.py_object,)
_view_of = ctypes.pythonapi.PyMemoryView_FromMemory
_view_of.restype = ctypes.py_object
_view_of.argtypes = (ctypes.c_void_p, ctypes.c_ssize_t, ctypes.c_int)


def uninitialized(size: int) -> tuple[bytes, memoryview]:
    """Return bytes with undefined content, and the view through which to write them.

    Do not use the bytes before all of them are written, and keep them while the view is used. CPython permits writing
    bytes that were just created (Python/C API, `PyBytes_AsString`). A bytearray would have to be copied where bytes are
    needed, 10 MB in 2 ms. `bytes(size)` writes zeros, so that all of its pages take memory at once; here a page takes
    memory when it is written.
    """
    content: bytes = _new_bytes(None, size)
    view: memoryview = _view_of(_address_of(content), size, _WRITABLE)
    return content, view
