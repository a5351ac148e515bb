"""Control calls: encoding, and the commands in `Execute`."""

from __future__ import annotations

import importlib
import pkgutil

import msgspec
import pytest

from rce.control import calls
from rce.control.calls.call import Call, result_type
from rce.control.calls.robots import Execute
from rce.control.connection import decode_pages, encode_pages
from rce.errors import InvalidRequest
from rce.protocol import messages as m
from tests.support.control import execute_round_trip


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
def test_command_is_unchanged_after_the_call(command: m.Command) -> None:
    assert execute_round_trip(command) == command


@pytest.mark.parametrize(("kind", "item"), [("Nothing", {}), ("Connect", {"tagA": 1}), ("Connect", [])])
def test_call_with_a_malformed_command_is_refused(kind: str, item: object) -> None:
    call = Execute("ann/r1", kind, msgspec.Raw(msgspec.msgpack.encode(item)))
    with pytest.raises(InvalidRequest):
        _ = decode_pages(encode_pages(call), Execute).command


def test_every_call_has_a_unique_name_and_a_result_and_can_be_decoded() -> None:
    for module in pkgutil.iter_modules(calls.__path__, f"{calls.__name__}."):
        importlib.import_module(module.name)
    kinds = [kind for kind in Call.__subclasses__() if kind.__module__.startswith(calls.__name__)]
    assert len({kind.__name__ for kind in kinds}) == len(kinds) > 40
    for kind in kinds:
        msgspec.msgpack.Decoder(kind)  # raises if msgspec cannot decode the type
        assert issubclass(result_type(kind), msgspec.Struct)
