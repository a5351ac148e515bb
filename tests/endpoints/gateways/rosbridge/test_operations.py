"""Decoding of operations."""

from __future__ import annotations

import sys

import msgspec
import pytest

from endpoints.gateways.rosbridge import operations as ops
from rce.errors import InvalidRequest


def test_values_are_not_decoded() -> None:
    operation = ops.decode(b'{"op": "publish", "topic": "/a", "msg": {"data": 1e400}, "id": 7}')
    assert isinstance(operation, ops.Publish)
    assert bytes(operation.msg) == b'{"data": 1e400}'
    assert ops.key(operation.id) == b"7"


def test_unknown_fields_are_ignored_and_null_is_the_default() -> None:
    text = b'{"op":"subscribe","topic":"/a","type":null,"fragment_size":null,"reconnect_on_close":true}'
    assert ops.decode(text) == ops.Subscribe(topic="/a", type=None)


@pytest.mark.parametrize(
    "text", [b"", b"[]", b"{}", b'{"op":"dance"}', b'{"op":"publish"}', b"\xff", b"[" * 100_000, b'{"op":1}']
)
def test_what_is_no_operation_is_refused(text: bytes) -> None:
    with pytest.raises(InvalidRequest, match="not an operation of rosbridge"):
        ops.decode(text)


def test_id_does_not_keep_its_message_in_memory() -> None:
    payload = b'{"op":"call_service","service":"/a","id":"x","args":{}}'
    before = sys.getrefcount(payload)
    id = ops.decode(payload).id
    assert ops.key(id) == b'"x"'
    assert sys.getrefcount(payload) == before


@pytest.mark.parametrize("id", [b'"%b"' % (b"x" * ops.MAX_ID), b'"\xff"'], ids=["long", "not UTF-8"])
def test_id_that_is_too_long_or_malformed_is_refused(id: bytes) -> None:
    with pytest.raises(InvalidRequest):
        ops.decode(b'{"op":"subscribe","topic":"/a","id":%b}' % id)


@pytest.fixture
def large(monkeypatch: pytest.MonkeyPatch) -> None:
    """Treat each operation as a large one."""
    monkeypatch.setattr(ops, "LARGE", 0)


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize(
    ("text", "field"),
    [
        (b'{"op":"publish","topic":"/a","msg":{"a":{"b":1}},"id":7}', "msg"),
        (b'{"msg" : {"data":"}, \\"msg\\":{"} , "op":"publish","topic":"/a"}', "msg"),
        (b'{"op":"call_service","service":"/a","args":{"msg":{}}}', "args"),
        (b'{"op":"service_response","service":"/a","id":"x","values":{"x":{}},"result":true}', "values"),
        (b'{"op":"send_action_goal","action":"/a","action_type":"t/A","args":{"order":5},"feedback":true}', "args"),
    ],
)
def test_content_of_a_large_operation_is_found(text: bytes, field: str) -> None:
    found = ops.decode(text)
    assert bytes(getattr(found, field)) in text
    assert msgspec.json.encode(found) == msgspec.json.encode(ops._decoder.decode(text))


@pytest.mark.usefixtures("large")
def test_content_of_a_large_operation_is_checked_when_it_is_converted() -> None:
    operation = ops.decode(b'{"op":"publish","topic":"/a","msg":{"a":[1,,2]}}')
    assert isinstance(operation, ops.Publish)
    assert bytes(operation.msg) == b'{"a":[1,,2]}'


@pytest.mark.usefixtures("large")
@pytest.mark.parametrize(
    "text",
    [
        b'{"op":"publish","topic":"/a","msg":{},"id":"a}"}',
        b'{"op":"publish","topic":"/a","msg":[]}',
        b'{"op":"publish","topic":"/a","x":{"msg":{}}}',
        b'{"op":"subscribe","topic":"/a","msg":{}}',
        b'{"op":"set_level","level":"none"}',
    ],
)
def test_unusual_large_operation_is_decoded_as_a_whole(text: bytes) -> None:
    assert msgspec.json.encode(ops.decode(text)) == msgspec.json.encode(ops._decoder.decode(text))
