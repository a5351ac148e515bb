"""Commands of robots in the call `Execute`."""

from __future__ import annotations

import msgspec
import pytest

from rce.control.calls.robots import Execute, PackedCommand
from rce.control.pages import decode_pages, encode_pages
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
    m.AddRecorder("a", "b", ["/scan"], 1, 2.5),
    m.RemoveRecorder("a", "b"),
    m.Connect("a/b", "c/d"),
    m.Disconnect("a/b", "c/d"),
], ids=lambda command: type(command).__name__)  # fmt: skip
def test_command_is_unchanged_after_the_call(command: m.Command) -> None:
    assert execute_round_trip(command) == command


@pytest.mark.parametrize(("kind", "item"), [("Nothing", {}), ("Connect", {"tagA": 1}), ("Connect", [])])
def test_call_with_a_malformed_command_is_refused(kind: str, item: object) -> None:
    call = Execute("ann/r1", [PackedCommand(kind, msgspec.Raw(msgspec.msgpack.encode(item)))])
    with pytest.raises(InvalidRequest):
        decode_pages(encode_pages(call), Execute).commands[0].unpack()
