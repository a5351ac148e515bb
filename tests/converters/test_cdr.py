"""Messages as they are."""

from __future__ import annotations

import pytest

from converters import Recipe, Wire
from converters.cdr import CdrCodec
from rce.errors import InvalidRequest

CODEC = CdrCodec(Recipe("std_msgs/msg/String", "png"))


def test_blob_of_a_message_is_its_cdr_both_ways() -> None:
    wire = CODEC.decode(b"\0\1\0\0")
    assert wire.is_blob
    assert CODEC.encode(wire) == b"\0\1\0\0"
    assert CODEC.encodes_fast(wire)
    assert CODEC.decodes_fast(bytes(10_000_000))


def test_message_that_is_no_blob_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="must be one blob"):
        CODEC.encode(Wire(False, b"{}", {}))
