"""Buffers for large messages."""

from __future__ import annotations

from endpoints.buffers import uninitialized


def test_uninitialized_buffer_has_its_size_and_can_be_written() -> None:
    buffer = uninitialized(10)
    buffer[:] = b"0123456789"
    assert buffer == b"0123456789"
    assert uninitialized(0) == b""
