"""Requests that create resources; their fields are those of the robots' commands."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rce.api.views.requests import NewConnection, NewEnvironment, NewInterface, NewNode, NewParameter
from rce.protocol.messages import AddInterface, AddNode, Connect, CreateContainer, SetParameter


@pytest.mark.parametrize(
    ("request_type", "command", "in_path"),
    [
        (NewEnvironment, CreateContainer, set()),
        (NewNode, AddNode, {"containerTag"}),
        (NewParameter, SetParameter, {"containerTag"}),
        (NewInterface, AddInterface, set()),
        (NewConnection, Connect, set()),
    ],
)
def test_request_has_the_fields_and_defaults_of_its_command(
    request_type: type[Any], command: type[Any], in_path: set[str]
) -> None:
    fields = {field.name: field.default for field in msgspec.structs.fields(command) if field.name not in in_path}
    assert {field.name: field.default for field in msgspec.structs.fields(request_type)} == fields


@pytest.mark.parametrize(
    ("request_type", "body"),
    [
        (NewEnvironment, {"containerTag": "a", "size": 2}),
        (NewEnvironment, {"containerTag": "a", "containerData": {"size": 0}}),
        (NewNode, {"nodeTag": "n", "pkg": "", "exe": "e"}),
        (NewNode, {"nodeTag": "n", "exe": "e"}),
        (NewParameter, {"name": "", "value": 1}),
        (NewParameter, {"name": "n", "value": None}),
        (NewInterface, {"endpointTag": "a", "interfaceTag": "b", "interfaceType": "Publisher", "className": "c/D"}),
        (NewConnection, {"tagA": "a/b", "tagB": "c/d", "qos": {}}),
    ],
)
def test_wrong_request_is_refused(request_type: type[Any], body: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(body, request_type)
