"""Statuses and errors as robots get them."""

from __future__ import annotations

import json

import msgspec

from rce.errors import ErrorInfo
from rce.protocol import messages as m


def test_status_and_error_are_encoded_as_in_the_original() -> None:
    status = m.Status(m.InterfaceStatus("pose", True))
    assert json.loads(msgspec.json.encode(status)) == {
        "type": "ST",
        "data": {"topic": "iu", "iTag": "pose", "status": True},
    }
    assert msgspec.json.encode(m.Failure("Invalid Request: …")) == '{"type":"ER","data":"Invalid Request: …"}'.encode()


def test_id_and_error_are_additional_keys_of_the_frame() -> None:
    failure = m.Failure("no", 7, ErrorInfo("not_found", "no", item="addNodes[0]"))
    assert json.loads(msgspec.json.encode(failure)) == {
        "type": "ER",
        "data": "no",
        "id": 7,
        "error": {"code": "not_found", "message": "no", "item": "addNodes[0]"},
    }
