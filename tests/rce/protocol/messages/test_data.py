"""Data messages: their value, a blob or an error."""

from __future__ import annotations

import json

import msgspec
import pytest
from msgspec import UNSET, Raw

from rce.errors import InvalidRequest
from rce.protocol.messages import DataMessage, decode_as


def test_value_and_blob_are_kept_as_json() -> None:
    value = decode_as(DataMessage, b'{"iTag":"a","type":"b/C","msgID":"1","msg":{"x": 1.50}}', "DM")
    assert (value.msg, value.blob) == (Raw(b'{"x": 1.50}'), UNSET)
    blob = decode_as(DataMessage, b'{"iTag":"a","type":"b/C","msgID":"1","msg*":"0a"}', "DM")
    assert (blob.msg, blob.blob) == (UNSET, Raw(b'"0a"'))


def test_error_response_has_no_value() -> None:
    text = msgspec.json.encode(DataMessage("serve", "std_srvs/SetBool", "1", error="stuck"))
    assert json.loads(text) == {"iTag": "serve", "type": "std_srvs/SetBool", "msgID": "1", "error": "stuck"}


@pytest.mark.parametrize("missing", ["iTag", "type", "msgID"])
def test_message_without_its_head_is_refused(missing: str) -> None:
    data = {"iTag": "a", "type": "b/C", "msgID": "1", "msg": {}}
    del data[missing]
    with pytest.raises(InvalidRequest, match=f"DM: .*{missing}"):
        decode_as(DataMessage, json.dumps(data).encode(), "DM")
