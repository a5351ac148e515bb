"""Messages of the Foxglove protocol."""

from __future__ import annotations

import struct
import time

import pytest

from endpoints.gateways.foxglove import messages
from endpoints.gateways.foxglove.messages import ServiceRequest
from rce.errors import InvalidRequest


def test_messages_of_clients_are_views_of_what_was_received() -> None:
    message = messages.decode_binary(b"\x01" + struct.pack("<I", 7) + b"cdr")
    assert message == (7, memoryview(b"cdr"))
    request = messages.decode_binary(b"\x02" + struct.pack("<III", 3, 4, 4) + b"jsonxyz")
    assert request == (3, 4, "json", memoryview(b"xyz"))


def test_frames_for_clients() -> None:
    frame = messages.message_data(9, b"cdr").join()
    opcode, subscription, stamp = struct.unpack_from("<BIQ", frame)
    assert (opcode, subscription, frame[13:]) == (1, 9, b"cdr")
    assert abs(stamp - time.time_ns()) < 60e9
    response = messages.service_response(ServiceRequest(3, 4, "cdr", memoryview(b"")), b"answer").join()
    assert response == b"\x03" + struct.pack("<III", 3, 4, 3) + b"cdranswer"
    assert messages.asset_error(5, "no").join() == struct.pack("<BIBI", 4, 5, 1, 2) + b"no"


@pytest.mark.parametrize(
    "payload", [b"", b"\x01", b"\x01\0\0", b"\x02\0\0\0\0", b"\x02" + struct.pack("<III", 1, 1, 99) + b"cdr", b"\x63"]
)
def test_binary_message_that_is_malformed_is_refused(payload: bytes) -> None:
    with pytest.raises(InvalidRequest):
        messages.decode_binary(payload)


@pytest.mark.parametrize("payload", [b"", b"{}", b'{"op":"dance"}', b'{"op":"subscribe"}', b"[" * 100_000, b"\xff"])
def test_text_that_is_no_message_is_refused(payload: bytes) -> None:
    with pytest.raises(InvalidRequest, match="Foxglove protocol"):
        messages.decode(payload)
