"""Operations for clients: JSON, fragments, PNG and CBOR."""

from __future__ import annotations

import base64
import json

import cbor2
import cv2
import numpy as np
import pytest

from endpoints.gateways.rosbridge import encoding
from endpoints.gateways.rosbridge.encoding import Form
from rce.errors import InvalidRequest
from tests.support.endpoints.fake_guest import decoded

VALUE = b'{"data":"\xc3\xa4' + b"x" * 500 + b'"}}'


def test_value_is_not_copied() -> None:
    (frame,) = encoding.with_value("msg", memoryview(VALUE), op="publish", topic="/a")
    assert frame.data.obj is VALUE  # type: ignore[union-attr]
    assert decoded([frame]) == [{"op": "publish", "topic": "/a", "msg": {"data": "ä" + "x" * 500}}]


def test_large_operation_is_sent_in_fragments() -> None:
    frames = decoded(encoding.with_value("msg", VALUE, Form("none", 200), op="publish", topic="/a"))
    assert [each["num"] for each in frames] == list(range(frames[0]["total"]))
    assert len({each["id"] for each in frames}) == 1
    assert json.loads("".join(each["data"] for each in frames))["topic"] == "/a"


def test_png_holds_the_text_in_its_pixels() -> None:
    (frame,) = decoded(encoding.with_value("msg", VALUE, Form("png"), op="publish", topic="/a"))
    assert frame["op"] == "png"
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(frame["data"]), np.uint8), cv2.IMREAD_COLOR_RGB)
    assert json.loads(pixels.tobytes())["msg"]["data"].startswith("ä")


def test_text_that_is_too_large_for_png_is_sent_as_it_is() -> None:
    value = b'"%b"}' % (b"x" * encoding.MAX_PNG)
    (frame,) = decoded(encoding.with_value("msg", value, Form("png"), op="publish"))
    assert frame["op"] == "publish"


@pytest.mark.parametrize("size", [4, 300, 70_000])
def test_cbor_has_the_value_as_its_last_field(size: int) -> None:
    (frame,) = decoded(encoding.cbor("msg", cbor2.dumps({"data": bytes(size)}), op="publish", topic="/a"))
    assert cbor2.loads(frame) == {"op": "publish", "topic": "/a", "msg": {"data": bytes(size)}}
    (frame,) = decoded(encoding.cbor_raw(bytes(size), op="publish", topic="/a"))
    raw = cbor2.loads(frame)["msg"]
    assert raw["bytes"] == bytes(size)
    assert raw["secs"] > 1_700_000_000


def test_list_of_arguments_becomes_an_object() -> None:
    assert encoding.object_of(b"[1, {}]", ["a", "b", "c"]) == b'{"a":1,"b":{}}'
    with pytest.raises(InvalidRequest, match="2 arguments"):
        encoding.object_of(b"[1, 2]", ["a"])
