"""Buffers for large messages."""

from __future__ import annotations

from rce.protocol.buffers import uninitialized


def test_uninitialized_bytes_have_their_size_and_can_be_written() -> None:
    content, view = uninitialized(10)
    view[:4] = b"0123"
    view[4:] = b"456789"
    assert content == b"0123456789"
    assert uninitialized(0)[0] == b""


def test_bytes_of_others_are_not_written() -> None:
    """CPython keeps one object for each single byte."""
    before = [bytes((number,)) for number in range(256)]
    content, view = uninitialized(1)
    view[:] = b"x" if content != b"x" else b"y"
    assert before == [bytes((number,)) for number in range(256)]
    assert [each[0] for each in before] == list(range(256)), "they were not written"
