# ruff: noqa: E501  # frames stand in one line, as on the wire
"""Frames of robots: what the original took is taken, and anything else is an InvalidRequest that says where."""

from __future__ import annotations

import importlib
import json
import math
import pkgutil
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rce import calls, control
from rce import messages as m
from rce.calls.call import Call, result_type
from rce.calls.robots import Execute
from rce.errors import ErrorInfo, InvalidRequest

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
    """A CN or CX with its items decoded, by their place."""
    kinds = {**m.CN_ITEMS, **m.CX_ITEMS}
    lists = msgspec.structs.asdict(m.decode_as(KINDS[frame.type], frame.data, "data"))
    return {
        f"{name}[{index}]": m.decode_as(kinds[name], raw, f"{name}[{index}]")
        for name, raws in lists.items()
        for index, raw in enumerate(raws)
    }


@pytest.mark.parametrize("text", TO_SERVER, ids=lambda text: text[9:11])
def test_what_the_original_takes_keeps_every_value(text: str) -> None:
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


def test_the_original_sees_its_status_and_error() -> None:
    status = m.Status(m.InterfaceStatus("pose", True))
    assert json.loads(msgspec.json.encode(status)) == {
        "type": "ST",
        "data": {"topic": "iu", "iTag": "pose", "status": True},
    }
    assert msgspec.json.encode(m.Failure("Invalid Request: …")) == '{"type":"ER","data":"Invalid Request: …"}'.encode()


def test_additions_stand_beside_type_and_data() -> None:
    failure = m.Failure("no", 7, ErrorInfo("not_found", "no", item="addNodes[0]"))
    assert json.loads(msgspec.json.encode(failure)) == {
        "type": "ER",
        "data": "no",
        "id": 7,
        "error": {"code": "not_found", "message": "no", "item": "addNodes[0]"},
    }


def test_defaults_and_unknown_keys() -> None:
    frame = m.decode_frame(b'{"more":1,"data":{"containerTag":"brain","colour":"red"},"type":"CC"}')
    assert frame.id is msgspec.UNSET
    command = m.decode_as(m.CreateContainer, frame.data, "data")
    assert (command.containerData.size, command.containerData.restart) == (1, "always")
    node = m.decode_as(m.AddNode, b'{"containerTag":"a","nodeTag":"b","pkg":"c","exe":"d"}', "x")
    assert (node.args, node.name, node.namespace) == ("", "", "")


# --- the tokens that JSON does not have -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ('{"x":NaN}', {"x": "NaN"}),
        ('{"x":[Infinity,-Infinity,1]}', {"x": ["Infinity", "-Infinity", 1]}),
        ('{"x":NaN,"NaN":"NaN, Infinity","s":"\\"NaN\\\\"}', {"x": "NaN", "NaN": "NaN, Infinity", "s": '"NaN\\'}),
    ],
)
def test_bare_tokens_become_their_names(text: str, value: object) -> None:
    frame = m.decode_frame(b'{"type":"DM","data":' + text.encode() + b"}")
    assert json.loads(bytes(frame.data)) == value


@given(
    st.recursive(
        st.floats() | st.text(),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    )
)
def test_what_pythons_json_writes_is_taken(value: object) -> None:
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


# --- errors -----------------------------------------------------------------------------------------------------------


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
        (m.AddInterface, '{"endpointTag":"a","interfaceTag":"b","interfaceType":"c","className":"d","qos":{"depth":0}}', "qos.depth"),
        (m.SetParameter, '{"containerTag":"a","name":"","value":1}', "name"),
        (m.SetParameter, '{"containerTag":"a","name":"a\\u0000b","value":1}', "name"),
        (m.SetParameter, json.dumps({"containerTag": "a", "name": "n" * 256, "value": 1}), "name"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":null}', "value"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":{"a":1}}', "value"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":[[1]]}', "value[0]"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":9223372036854775808}', "value"),
        (m.SetParameter, '{"containerTag":"a","name":"n","value":[0,-9223372036854775809]}', "value[1]"),
        (m.Connect, "[]", ""),
        (m.ConfigureComponents, '{"addNodes":{}}', "addNodes"),
    ],
)  # fmt: skip
def test_an_error_names_the_item_and_the_path_of_the_field(kind: type[Any], text: str, field: str) -> None:
    with pytest.raises(InvalidRequest) as raised:
        m.decode_as(kind, text.encode(), "connect[3]")
    assert raised.value.field == field
    assert str(raised.value).startswith("connect[3]" + (f".{field}: " if field else ": "))


def test_items_before_a_bad_one_are_still_good() -> None:
    lists = m.decode_as(m.ConfigureConnections, b'{"connect":[{"tagA":"a/b","tagB":"c/d"},{"tagA":1}]}', "data")
    assert m.decode_as(m.Connect, lists.connect[0], "connect[0]") == m.Connect("a/b", "c/d")
    with pytest.raises(InvalidRequest, match=r"connect\[1\]"):
        m.decode_as(m.Connect, lists.connect[1], "connect[1]")


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
def test_a_bad_frame_is_an_invalid_request(payload: bytes) -> None:
    with pytest.raises(InvalidRequest):
        m.decode_frame(payload)


def decode_all(payload: bytes) -> None:
    """All that a server decodes of a frame, and passes on to the Master."""
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
            assert through_wire(decoded) == decoded


def through_wire(command: m.Command) -> m.Command:
    pages = control._pages(Execute.of("ann/r1", command))
    return control._value(pages, Execute).command


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text() | st.sampled_from(["containerTag", "name", "value", "tagA", "tagB", "containerData", "size"]), inner, max_size=6),
)  # fmt: skip


@given(st.sampled_from([*KINDS, "ST", "?"]), values)
@example("CC", {"containerTag": "a", "containerData": {"cpu": 10**400}})
@example("CN", {"containerTag": "a", "name": "n", "value": 2**64})
def test_any_json_is_taken_or_refused(kind: str, data: object) -> None:
    decode_all(json.dumps({"type": kind, "data": data}).encode())


@given(st.sampled_from(TO_SERVER), st.integers(0, 400), st.binary(max_size=8), st.integers(0, 8))
def test_any_damage_is_taken_or_refused(text: str, place: int, put: bytes, cut: int) -> None:
    payload = text.encode()
    decode_all(payload[:place] + put + payload[place + cut :])


@given(st.binary())
def test_any_bytes_are_taken_or_refused(payload: bytes) -> None:
    decode_all(payload)


# --- on the way to the Master -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [
    m.CreateContainer("a", m.ContainerData(size=2, specialFeatures=["gpu"])),
    m.DestroyContainer("a"),
    m.AddNode("a", "n", "p", "e", "-x"),
    m.RemoveNode("a", "n"),
    m.AddInterface("a", "i", "PublisherInterface", "a/B", qos=m.Qos(history="keep_all")),
    m.RemoveInterface("a", "i"),
    m.SetParameter("a", "n", [1, 2.5, "x", True]),
    m.DeleteParameter("a", "n"),
    m.Connect("a/b", "c/d"),
    m.Disconnect("a/b", "c/d"),
], ids=lambda command: type(command).__name__)  # fmt: skip
def test_a_command_crosses_to_the_master(command: m.Command) -> None:
    assert through_wire(command) == command


@pytest.mark.parametrize(("kind", "item"), [("Nothing", {}), ("Connect", {"tagA": 1}), ("Connect", [])])
def test_no_other_command_crosses(kind: str, item: object) -> None:
    call = Execute("ann/r1", kind, msgspec.Raw(msgspec.msgpack.encode(item)))
    with pytest.raises(InvalidRequest):
        _ = control._value(control._pages(call), Execute).command


def test_every_call_has_a_name_of_its_own_and_a_result_and_crosses() -> None:
    for module in pkgutil.iter_modules(calls.__path__, f"{calls.__name__}."):
        importlib.import_module(module.name)
    kinds = [kind for kind in Call.__subclasses__() if kind.__module__.startswith(calls.__name__)]
    assert len({kind.__name__ for kind in kinds}) == len(kinds) > 40
    for kind in kinds:
        msgspec.msgpack.Decoder(kind)  # raises where a type cannot be decoded
        assert issubclass(result_type(kind), msgspec.Struct)
