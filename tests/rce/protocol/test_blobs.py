"""References to blobs in JSON, and the binary frames that carry blobs."""

from __future__ import annotations

import json
import time

import pytest

from rce.errors import InvalidRequest
from rce.protocol.blobs import PART, attach, binary_frames, detach, find_references

A, B = "a" * 32, "B1" * 16


def test_references_at_any_depth_in_order_and_once() -> None:
    data = {"msg*": B, "n": {"list": [{"x*": A}, {"y*": [A, B]}], "empty*": []}}
    for indent in (None, 3):
        assert find_references(json.dumps(data, indent=indent).encode()) == [B, A]


def test_strings_that_look_like_references_are_ignored() -> None:
    inner = json.dumps({"msg*": A})
    assert find_references(json.dumps({"data": inner, "star": "*", "list": ["*", f'*":"{A}"']}).encode()) == []


@pytest.mark.parametrize("value", ["5", '"abc"', f'["{A}",3]', f'["{A}"', "{}", '"' + "g" * 32 + '"'])
def test_error_names_a_malformed_reference(value: str) -> None:
    with pytest.raises(InvalidRequest, match=r"image\*"):
        find_references(f'{{"image*": {value}}}'.encode())


def test_references_in_hostile_json_take_linear_time() -> None:
    def cost(count: int) -> float:
        text = b'{"x":[' + b'"*",' * count + b'"*" ' + b" " * count + b"]}"
        begin = time.process_time()
        assert find_references(text) == []
        return time.process_time() - begin

    cost(1000)
    assert cost(1_000_000) < 5  # quadratic time would be hours


def test_detach_and_attach_round_trip() -> None:
    value = {"msg": b"png", "deep": [{"x": b""}, {"y": [b"1", bytearray(b"2")]}], "n": [1.5, 2], "s": "text", "e": []}
    wire, blobs = detach(value)
    assert len(blobs) == 4
    text = json.dumps(wire)
    assert set(find_references(text.encode())) == set(blobs)
    assert attach(json.loads(text), blobs) == value
    assert value["msg"] == b"png"


def test_attach_ignores_references_without_a_blob() -> None:
    assert attach({"x*": "short", "y*": [A, []], "z*": 5}, {}) == {"x*": "short", "y*": [A, []], "z*": 5}
    assert attach({"x*": []}, {}) == {"x": []}


def test_attach_handles_deeply_nested_values() -> None:
    value: dict[str, object] = {"x*": A}
    for _ in range(100_000):
        value = {"in": [value]}
    found = attach(value, {A: b"z"})
    for _ in range(100_000):
        found = found["in"][0]
    assert found == {"x": b"z"}


@pytest.mark.parametrize("value", [b"x", [b"x"], {"a": [[b"x"]]}, {"a": [{}, b"x"]}])
def test_blob_without_a_key_is_refused(value: object) -> None:
    with pytest.raises(InvalidRequest, match="blob"):
        detach(value)


def test_binary_frames_whole_and_in_parts() -> None:
    blob = bytes(range(256)) * 1025
    assert [frame.join() for frame in binary_frames({A: blob}, parts=False)] == [A.encode() + blob]
    first, second = (frame.join() for frame in binary_frames({A: blob}, parts=True))
    total = len(blob).to_bytes(4, "big")
    assert first == A.encode() + b"\0\0\0\0" + total + blob[:PART]
    assert second == A.encode() + PART.to_bytes(4, "big") + total + blob[PART:]
    assert [frame.join() for frame in binary_frames({A: b""}, parts=True)] == [A.encode() + bytes(8)]
