# ruff: noqa: E501  # frames stand in one line, as on the wire
"""Frames of robots: those of the original protocol decode, and all others raise an InvalidRequest with the place."""

from __future__ import annotations

import json
import math
import time
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rce.errors import InvalidRequest
from rce.protocol import messages as m
from rce.protocol.messages.frames import MAX_LENIENT, decode_frame
from tests.support.control import execute_round_trip

KINDS: dict[str, type[Any]] = {
    "CC": m.CreateContainer,
    "DC": m.DestroyContainer,
    "CN": m.ConfigureComponents,
    "CX": m.ConfigureConnections,
    "DM": m.DataMessage,
}
TO_SERVER = [
    '{"type":"CC","data":{"containerTag":"brain","containerData":{"size":2,"group":"fleet"}}}',
    '{"type":"DC","data":{"containerTag":"brain"}}',
    """{"type":"CN","data":{
  "setParam":[{"containerTag":"brain","name":"rate","value":10}],
  "addInterfaces":[
    {"endpointTag":"r2d2","interfaceTag":"pose","interfaceType":"SubscriberConverter","className":"geometry_msgs/Pose2D"},
    {"endpointTag":"brain","interfaceTag":"pose","interfaceType":"PublisherInterface","className":"geometry_msgs/Pose2D","addr":"/pose"}]}}""",
    '{"type":"CN","data":{"addNodes":[{"containerTag":"brain","nodeTag":"rec","pkg":"demo","exe":"rec.py","args":"--dir $(find demo)/out","name":"rec","namespace":"log"}]}}',
    '{"type":"CN","data":{"removeNodes":[{"containerTag":"brain","nodeTag":"rec"}],"removeInterfaces":[{"endpointTag":"r2d2","interfaceTag":"pose"}],"deleteParam":[{"containerTag":"brain","name":"rate"}]}}',
    '{"type":"CX","data":{"connect":[{"tagA":"r2d2/pose","tagB":"brain/pose"}]}}',
    '{"type":"CX","data":{"disconnect":[{"tagA":"brain/pose","tagB":"r2d2/pose"}]}}',
    '{"type":"DM","data":{"iTag":"pose","type":"geometry_msgs/Pose2D","msgID":"nil","msg":{"x":1.5,"y":-0.5,"theta":0.0}}}',
    '{"type":"DM","data":{"iTag":"camera","type":"sensor_msgs/Image","msgID":"nil","msg*":"0a1b2c3d4e5f60718293a4b5c6d7e8f9"}}',
    '{"type":"DM","data":{"iTag":"echo","type":"Test/StringEcho","msgID":"5d0c8a","msg":{"data":"hi"}}}',
]


def items(frame: m.Frame) -> dict[str, Any]:
    """Return the decoded items of a CN or CX frame by their place."""
    kinds = {**m.CN_ITEMS, **m.CX_ITEMS}
    lists = msgspec.structs.asdict(m.decode_as(KINDS[frame.type], frame.data, "data"))
    return {
        f"{name}[{index}]": m.decode_as(kinds[name], raw, f"{name}[{index}]")
        for name, raws in lists.items()
        for index, raw in enumerate(raws)
    }


@pytest.mark.parametrize("text", TO_SERVER, ids=lambda text: text[9:11])
def test_frames_of_the_original_protocol_keep_every_value(text: str) -> None:
    frame = m.decode_frame(text.encode())
    data = json.loads(text)["data"]
    if frame.type in ("CN", "CX"):
        decoded = items(frame)
        assert set(decoded) == {f"{name}[{index}]" for name, each in data.items() for index, _ in enumerate(each)}
        given = {f"{name}[{index}]": item for name, each in data.items() for index, item in enumerate(each)}
        for place, item in decoded.items():
            assert msgspec.to_builtins(item).items() >= given[place].items()
        return
    decoded_message = m.decode_as(KINDS[frame.type], frame.data, "data")
    assert json.loads(msgspec.json.encode(decoded_message)) == data


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ('{"x":NaN}', {"x": "NaN"}),
        ('{"x":[Infinity,-Infinity,1]}', {"x": ["Infinity", "-Infinity", 1]}),
        ('{"x":NaN,"NaN":"NaN, Infinity","s":"\\"NaN\\\\"}', {"x": "NaN", "NaN": "NaN, Infinity", "s": '"NaN\\'}),
    ],
)
def test_bare_tokens_are_decoded_as_strings(text: str, value: object) -> None:
    frame = m.decode_frame(b'{"type":"DM","data":' + text.encode() + b"}")
    assert json.loads(bytes(frame.data)) == value


@given(
    st.recursive(
        st.floats() | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    )
)
def test_output_of_pythons_json_module_is_decoded(value: object) -> None:
    def named(value: object) -> object:
        if isinstance(value, dict):
            return {key: named(each) for key, each in value.items()}
        if isinstance(value, list):
            return [named(each) for each in value]
        if isinstance(value, float) and not math.isfinite(value):
            return json.dumps(value)
        return value

    payload = json.dumps({"type": "DM", "data": value}).encode()
    assert json.loads(bytes(m.decode_frame(payload).data)) == named(value)


HOSTILE = [
    b"",
    b"\xff\xfe",
    b"null",
    b"[]",
    b"{}",
    b'"CC"',
    b'{"type":"CC"}',
    b'{"type":null,"data":{}}',
    b'{"type":"CC","data":{}',
    b'{"type":"CC","data":{}} {}',
    b'{"type":"C\xff","data":{}}',
    b'{"type":"\\ud800","data":{}}',
    b'{"type":"CC","data":{"a":NaN',
    b'{"type":"CC","data":"NaN\\',
    b'{"type":"CC","data":{},"id":1e999}',
    b'{"type":"CC","data":{},"id":true}',
    b'{"type":"CC","data":{},"id":"' + b"x" * 256 + b'"}',
    b'{"type":"CC","data":' + b"[" * 200_000,
    b'{"type":"CC","data":' + b"[" * 200_000 + b"]" * 200_000 + b"}",
    b'{"type":"CC","data":' + b'{"a":' * 100_000 + b"NaN" + b"}" * 100_001,
]


@pytest.mark.parametrize("payload", HOSTILE, ids=lambda payload: repr(payload[:25]))
def test_malformed_frame_is_an_invalid_request(payload: bytes) -> None:
    with pytest.raises(InvalidRequest):
        m.decode_frame(payload)


def decode_all(payload: bytes) -> None:
    """Decode a frame as every kind of message, as the server does, and pass commands on as the Master gets them."""
    try:
        frame = m.decode_frame(payload)
    except InvalidRequest:
        return
    for kind in (*KINDS.values(), *get_args(m.Command)):
        try:
            decoded = m.decode_as(kind, frame.data, "data")
        except InvalidRequest:
            continue
        if isinstance(decoded, get_args(m.Command)):
            assert execute_round_trip(decoded) == decoded


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text() | st.sampled_from(["containerTag", "name", "value", "tagA", "tagB", "containerData", "size"]), inner, max_size=6),
)  # fmt: skip


@given(st.sampled_from([*KINDS, "ST", "?"]), values)
@example("CC", {"containerTag": "a", "containerData": {"cpu": 10**400}})
@example("CN", {"containerTag": "a", "name": "n", "value": 2**64})
def test_any_json_is_decoded_or_refused(kind: str, data: object) -> None:
    decode_all(json.dumps({"type": kind, "data": data}).encode())


@given(st.sampled_from(TO_SERVER), st.integers(0, 400), st.binary(max_size=8), st.integers(0, 8))
def test_any_damaged_frame_is_decoded_or_refused(text: str, place: int, put: bytes, cut: int) -> None:
    payload = text.encode()
    decode_all(payload[:place] + put + payload[place + cut :])


@given(st.binary())
def test_any_bytes_are_decoded_or_refused(payload: bytes) -> None:
    decode_all(payload)


@pytest.mark.parametrize(
    "text", [b'"\\' * 500_000, b'"a",' * 250_000, b"-" * 1_000_000, b"N" * 1_000_000, b"NaN," * 250_000], ids=range(5)
)
def test_malformed_frame_with_a_token_is_refused_in_linear_time(text: bytes) -> None:
    """With a backslash after each quote it took hours, in the event loop of the Robot endpoint."""
    began = time.process_time()
    with pytest.raises(InvalidRequest):
        decode_frame(b'{"a":NaN,' + text)
    assert time.process_time() - began < 5


def test_tokens_are_accepted_up_to_a_size() -> None:
    start = b'{"type":"DM","data":[NaN,-Infinity,"NaN"'
    assert bytes(decode_frame(start + b"]}").data) == b'["NaN","-Infinity","NaN"]'
    with pytest.raises(InvalidRequest):
        decode_frame(start + b" " * MAX_LENIENT + b"]}")
