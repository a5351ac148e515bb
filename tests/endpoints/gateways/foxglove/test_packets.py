"""Packets in the types that viewers decode."""

from __future__ import annotations

import base64
from typing import Any

import msgspec
import pytest

from converters import TypeRegistry
from endpoints.gateways.foxglove.packets import TYPES, Packing
from endpoints.gateways.uses import Arrived
from rce.protocol.messages import DataMessage
from rce.protocol.names import parse_type

HEAD = {"header": {"stamp": {"sec": 7, "nanosec": 8}, "frame_id": "cam"}, "number": 3, "data*": "0" * 32}


@pytest.mark.parametrize("codec", TYPES)
def test_packet_keeps_its_data_and_header(codec: str) -> None:
    arrived = Arrived(DataMessage("u1", TYPES[codec][0], "nil"), msgspec.json.encode(HEAD) + b"}", b"\0data")
    cdr = Packing(codec).cdr(arrived)
    got: dict[str, Any] = msgspec.json.decode(TypeRegistry().message(parse_type(TYPES[codec][1])).decode(cdr).raw)
    assert (got["timestamp"], got["frame_id"], got["format"]) == (HEAD["header"]["stamp"], "cam", codec)  # type: ignore[index]
    assert base64.b64decode(got["data"]) == b"\0data"
    if codec == "draco":
        assert got["pose"]["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1}, "no rotation"
