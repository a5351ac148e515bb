# ruff: noqa: E501  # items stand in one line, as on the wire
"""Commands of robots: defaults of their fields, and the place of a wrong field."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest

from rce.errors import InvalidRequest
from rce.protocol import messages as m


def test_defaults_apply_and_unknown_keys_are_ignored() -> None:
    frame = m.decode_frame(b'{"more":1,"data":{"containerTag":"brain","colour":"red"},"type":"CC"}')
    assert frame.id is msgspec.UNSET
    command = m.decode_as(m.CreateContainer, frame.data, "data")
    assert (command.containerData.size, command.containerData.restart) == (1, "always")
    node = m.decode_as(m.AddNode, b'{"containerTag":"a","nodeTag":"b","pkg":"c","exe":"d"}', "x")
    assert (node.args, node.name, node.namespace) == ("", "", "")


@pytest.mark.parametrize(
    ("kind", "text", "field"),
    [
        (m.CreateContainer, "{}", ""),
        (m.CreateContainer, '{"containerTag":1}', "containerTag"),
        (m.CreateContainer, '{"containerTag":"a","containerData":{"size":0}}', "containerData.size"),
        (m.CreateContainer, '{"containerTag":"a","containerData":{"size":1001}}', "containerData.size"),
        (m.CreateContainer, '{"containerTag":"a","containerData":{"size":"2"}}', "containerData.size"),
        (m.CreateContainer, '{"containerTag":"a","containerData":{"size":true}}', "containerData.size"),
        (m.CreateContainer, '{"containerTag":"a","containerData":{"memory":-1}}', "containerData.memory"),
        (m.CreateContainer, '{"containerTag":"a","containerData":{"memory":9999999999999999999999}}', "containerData.memory"),
        (m.CreateContainer, '{"containerTag":"a","containerData":{"specialFeatures":[1]}}', "containerData.specialFeatures[0]"),
        (m.CreateContainer, '{"containerTag":"a","containerData":{"restart":"maybe"}}', "containerData.restart"),
        (m.AddNode, '{"containerTag":"a","nodeTag":"b","pkg":"","exe":"d"}', "pkg"),
        (m.AddNode, '{"containerTag":"a","nodeTag":"b","pkg":"c","exe":"d","args":"x\\u0000"}', "args"),
        (m.AddNode, json.dumps({"containerTag": "a", "nodeTag": "b", "pkg": "c", "exe": "d", "args": "x" * 32_769}), "args"),
        (m.AddInterface, '{"endpointTag":"a","interfaceTag":"b","interfaceType":"c","className":"d","qos":{"depth":-1}}', "qos.depth"),
        (m.AddInterface, '{"endpointTag":"a","interfaceTag":"b","interfaceType":"c","className":"d","addr":"/a\\u0000"}', "addr"),
        (m.AddRecorder, '{"containerTag":"a","recorderTag":"b","topics":["/a b"]}', "topics[0]"),
        (m.SetParameter, '{"containerTag":"a","name":"","value":1}', "name"),
        (m.SetParameter, '{"containerTag":"a","name":"a\\u0000b","value":1}', "name"),
        (m.SetParameter, json.dumps({"containerTag": "a", "name": "n" * 256, "value": 1}), "name"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":null}', "value"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":9223372036854775808}', "value"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":[0,-9223372036854775809]}', "value"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":{"a":[99999999999999999999]}}', "value"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":' + "[" * 33 + "]" * 33 + "}", "value"),
        (m.Connect, "[]", ""),
        (m.ConfigureComponents, '{"addNodes":{}}', "addNodes"),
    ],
)  # fmt: skip
def test_error_names_the_item_and_the_path_of_the_field(kind: type[Any], text: str, field: str) -> None:
    with pytest.raises(InvalidRequest) as raised:
        m.decode_as(kind, text.encode(), "connect[3]")
    assert raised.value.field == field
    assert str(raised.value).startswith("connect[3]" + (f".{field}: " if field else ": "))


@pytest.mark.parametrize("name", ["", "1A", "A-B", "A=B", "A\n", "Ä", "x" * 256])
def test_name_that_no_environment_variable_has_is_refused(name: str) -> None:
    data = {"containerTag": "a", "containerData": {"env": {name: "value"}}}
    with pytest.raises(InvalidRequest, match="env"):
        m.decode_as(m.CreateContainer, json.dumps(data).encode(), "CC")


def test_malformed_item_does_not_affect_the_items_before() -> None:
    lists = m.decode_as(m.ConfigureConnections, b'{"connect":[{"tagA":"a/b","tagB":"c/d"},{"tagA":1}]}', "data")
    assert m.decode_as(m.Connect, lists.connect[0], "connect[0]") == m.Connect("a/b", "c/d")
    with pytest.raises(InvalidRequest, match=r"connect\[1\]"):
        m.decode_as(m.Connect, lists.connect[1], "connect[1]")
