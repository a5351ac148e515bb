"""Messages as namespaces of their fields."""

from __future__ import annotations

import pytest

from converters import TypeRegistry, Wire
from converters.namespaces import Namespaces
from converters.scalars import FieldError
from rce.protocol.names import parse_type

CODEC = TypeRegistry().message(parse_type("sensor_msgs/LaserScan"))
CDR = CODEC.encode(Wire(False, b'{"angle_min":1.5,"ranges":[1.0,"NaN"],"header":{"frame_id":"laser"}}', {}))


def test_message_is_read_and_written_unchanged() -> None:
    namespaces = Namespaces(CODEC.message)
    fields = namespaces.read(CDR)
    assert (fields.angle_min, len(fields.ranges)) == (1.5, 2)
    assert namespaces.write(fields) == CDR


def test_bytes_that_are_no_cdr_are_refused() -> None:
    with pytest.raises(FieldError, match="little-endian"):
        Namespaces(CODEC.message).read(b"\0\0\0\0")
