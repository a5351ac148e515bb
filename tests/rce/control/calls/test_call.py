"""Types of all control calls: their names, results and encoding."""

from __future__ import annotations

import importlib
import pkgutil

import msgspec

from rce.control import calls
from rce.control.calls.call import BatchResult, Call, Nothing, result_type
from rce.control.calls.endpoints import StopNode, Sync
from rce.control.calls.watching import Log, ReadLog


def test_result_type_is_that_of_the_class() -> None:
    assert [result_type(call) for call in (StopNode, Sync, ReadLog)] == [Nothing, BatchResult, Log]


def test_every_call_has_a_unique_name_and_a_result_and_can_be_decoded() -> None:
    for module in pkgutil.iter_modules(calls.__path__, f"{calls.__name__}."):
        importlib.import_module(module.name)
    kinds = [kind for kind in Call.__subclasses__() if kind.__module__.startswith(calls.__name__)]
    assert len({kind.__name__ for kind in kinds}) == len(kinds) > 40
    for kind in kinds:
        msgspec.msgpack.Decoder(kind)  # raises if msgspec cannot decode the type
        assert issubclass(result_type(kind), msgspec.Struct)
