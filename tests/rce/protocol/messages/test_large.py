"""Large data messages: the envelope that is decoded alone is that of the whole frame."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec import Raw

from rce.errors import InvalidRequest, RceError
from rce.protocol.messages import DataMessage, decode_as, decode_frame, envelope_of, split_large
from rce.protocol.messages.large import MARK

text = st.text(st.sampled_from('ab{}[]",:\\* é'), max_size=8)
content = st.recursive(
    st.none() | st.booleans() | st.integers() | text,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(text | st.just("msg"), inner, max_size=3),
    max_leaves=8,
)


def _shuffled(keys: dict[str, Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.permutations(list(keys.items())).map(dict)


@st.composite
def frames(draw: st.DrawFn) -> dict[str, Any]:
    """Return a frame whose keys are in any order, and some of them wrong or missing."""
    data = {"iTag": draw(text), "type": draw(text), "msgID": draw(text), "msg": draw(content)}
    data |= draw(st.dictionaries(text | st.sampled_from(["stream", "number", "msg*", "phase"]), content, max_size=2))
    frame: dict[str, Any] = {"type": draw(st.sampled_from(["DM", "DM", "DM", "CN"])), "data": draw(_shuffled(data))}
    frame |= draw(st.dictionaries(st.sampled_from(["id", "msg", "x"]), content, max_size=1))
    return draw(_shuffled(frame))


def whole(payload: bytes) -> DataMessage:
    return decode_as(DataMessage, decode_frame(payload).data, "data")


@given(frames(), st.sampled_from([None, 1]))
@example({"type": "DM", "data": {"iTag": "a", "type": "b", "msgID": "", "msg": {}, "stream": {}}}, None)
@example({"type": "DM", "data": {"iTag": "a", "type": "b", "msgID": "", "msg": {}}, "id": {"a": {}}}, None)
@example({"type": "DM", "data": {"iTag": "a", "type": "b", "msgID": "", "msg": {}}, "x": {"a": {}}}, None)
@example({"type": "DM", "data": {"iTag": "", "type": "", "msgID": "", "msg": None}, "x": {"msg": {}}}, None)
@example({"type": "DM", "data": {"iTag": "", "type": "", "msgID": "", "msg": -0.0}, "x": {"msg": {}}}, None)
def test_split_message_is_that_of_the_whole_frame(frame: dict[str, Any], indent: int | None) -> None:
    payload = json.dumps(frame, indent=indent, ensure_ascii=False).encode()
    large = split_large(payload)
    if large is None:
        return
    found = large.message
    try:
        identity, expected = decode_frame(payload).id, whole(payload)
    except InvalidRequest:
        assert isinstance(found.msg, Raw)
        with pytest.raises(json.JSONDecodeError):  # its converter refuses it, too
            json.loads(bytes(found.msg))
        return
    assert large.frame.id == identity
    for name in DataMessage.__struct_fields__:
        one, other = getattr(expected, name), getattr(found, name)
        if name == "msg":
            try:
                assert json.loads(bytes(other)) == json.loads(bytes(one))
            except json.JSONDecodeError:
                assert re.match(re.escape(bytes(one)) + rb"\s*[,}]", bytes(other)), "its converter refuses what follows"
        else:
            assert one == other


@pytest.mark.parametrize(
    "payload",
    [
        b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil","msg":{"x":[1,2]}}}',
        b'{"id":7,"data":{"msg": {"x":[1,2]},"iTag":"a","msgID":"nil","type":"b/C"},"type":"DM"}',
        b' {"type":"DM","id":"q","data":{"iTag":"a","type":"b/C","msgID":"nil","msg":\n{"x":[1,2]} } }\n',
        b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil","msg":{"x":[1,2]},"stream":"s","number":3},"id":"s/3"}',
    ],
)
def test_usual_messages_are_split(payload: bytes) -> None:
    large = split_large(payload)
    assert large is not None
    assert isinstance(large.message.msg, Raw)
    assert json.loads(bytes(large.message.msg)) == {"x": [1, 2]}
    assert (large.message.iTag, large.message.type, large.message.msgID) == ("a", "b/C", "nil")
    assert large.message.number == whole(payload).number


@pytest.mark.parametrize(
    "payload",
    [
        b'{"type":"CN","data":{"setParam":[{"containerTag":"a","name":"b","value":{"msg":{}}}]}}',
        b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil","msg*":"' + b"0" * 32 + b'"}}',
        b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil","msg":{"pixels*":"' + b"0" * 32 + b'"}}}',
        b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil","msg":{"pixels*" : "' + b"0" * 32 + b'"}}}',
        b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil","msg":[1]}}',
        b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil"},"msg":{"x":1}}',
        b"}}}",
        b"",
    ],
)
def test_other_frames_are_not_split(payload: bytes) -> None:
    assert split_large(payload) is None


def test_envelope_of_a_large_frame_has_its_id_and_no_data() -> None:
    payload = json.dumps({"type": "CN", "data": {"x": "y" * 10_000_000}, "id": 7}).encode()
    frame = envelope_of(payload)
    assert frame is not None
    assert (frame.type, frame.id, bytes(frame.data)) == ("CN", 7, MARK)


@pytest.mark.parametrize(
    "frame", [{"type": "CN", "data": 1}, {"data": {"x": {}}, "type": "CN", "y": "z" * 10_000}, {"data": {}}]
)
def test_unusual_frame_has_no_envelope(frame: dict[str, Any]) -> None:
    assert envelope_of(json.dumps(frame).encode()) is None


def test_text_that_ends_with_an_asterisk_is_no_reference_to_a_blob() -> None:
    payload = b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil","msg":{"x":["all *","*"]}}}'
    large = split_large(payload)
    assert large is not None
    assert bytes(large.message.msg) == b'{"x":["all *","*"]}'  # type: ignore[arg-type]  # it is set


def test_content_that_is_no_json_is_left_to_the_converter() -> None:
    payload = b'{"type":"DM","data":{"iTag":"a","type":"b/C","msgID":"nil","msg":{"x":[1,2}}}'
    large = split_large(payload)
    assert large is not None
    assert bytes(large.message.msg) == b'{"x":[1,2}'  # type: ignore[arg-type]  # it is set
    with pytest.raises(RceError):
        whole(payload)
