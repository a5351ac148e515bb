"""Messages of the Foxglove protocol."""

from __future__ import annotations

import struct
import time

import pytest

from endpoints.gateways.foxglove import messages
from endpoints.gateways.foxglove.messages import ServiceRequest
from rce.bag.playback import PlaybackState
from rce.errors import InvalidRequest, LimitExceeded


def test_messages_of_clients_are_views_of_what_was_received() -> None:
    message = messages.decode_binary(b"\x01" + struct.pack("<I", 7) + b"cdr")
    assert message == (7, memoryview(b"cdr"))
    request = messages.decode_binary(b"\x02" + struct.pack("<III", 3, 4, 4) + b"jsonxyz")
    assert request == (3, 4, "json", memoryview(b"xyz"))
    command = messages.decode_binary(b"\x03" + struct.pack("<BfBQI", 1, 0.5, 1, 7, 2) + b"id")
    assert command == (False, 0.5, 7, "id")
    assert messages.decode_binary(b"\x03" + struct.pack("<BfBQI", 0, 1.0, 0, 7, 0)) == (True, 1.0, None, "")


def test_frames_for_clients() -> None:
    frame = messages.message_data(9, b"cdr").join()
    opcode, subscription, stamp = struct.unpack_from("<BIQ", frame)
    assert (opcode, subscription, frame[13:]) == (1, 9, b"cdr")
    assert abs(stamp - time.time_ns()) < 60e9
    response = messages.service_response(ServiceRequest(3, 4, "cdr", memoryview(b"")), b"answer").join()
    assert response == b"\x03" + struct.pack("<III", 3, 4, 3) + b"cdranswer"
    assert messages.asset_error(5, "no").join() == struct.pack("<BIBI", 4, 5, 1, 2) + b"no"
    assert messages.asset(5, b"mesh").join() == struct.pack("<BIBI", 4, 5, 0, 0) + b"mesh"
    assert messages.time(9).join() == struct.pack("<BQ", 2, 9)
    state = PlaybackState("ended", 9, 2.0, 1, 9, "id")
    assert messages.playback_state(state).join() == struct.pack("<BBQfBI", 5, 3, 9, 2.0, 0, 2) + b"id"


@pytest.mark.parametrize(
    "payload",
    [b"", b"\x01", b"\x01\0\0", b"\x02\0\0\0\0", b"\x02" + struct.pack("<III", 1, 1, 99) + b"cdr", b"\x63"]
    + [
        b"\x03" + struct.pack("<BfBQI", *fields) for fields in ((2, 1.0, 0, 0, 0), (0, 0.0, 0, 0, 0), (0, 1.0, 0, 0, 9))
    ],
)
def test_binary_message_that_is_malformed_is_refused(payload: bytes) -> None:
    with pytest.raises(InvalidRequest):
        messages.decode_binary(payload)


@pytest.mark.parametrize(
    "payload",
    [
        *(b"", b"{}", b'{"op":"dance"}', b'{"op":"subscribe"}', b"[" * 100_000, b"\xff"),
        b'{"op":"subscribe","subscriptions":[{"id":4294967296,"channelId":1}]}',
        b'{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}',
        b'{"op":"fetchAsset","uri":"package://a/b","requestId":4294967296}',
    ],
)
def test_text_that_is_no_message_is_refused(payload: bytes) -> None:
    with pytest.raises(InvalidRequest, match="Foxglove protocol"):
        messages.decode(payload)


def test_text_with_too_many_values_is_refused() -> None:
    names = ",".join(['"x"'] * 10_002)
    with pytest.raises(LimitExceeded, match="the message has more than 10000 values"):
        messages.decode(f'{{"op":"getParameters","parameterNames":[{names}]}}'.encode())
