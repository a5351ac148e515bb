"""Steps of the conversion of ROS 1: alignment of what they write, and types that ROS 1 cannot have."""

from __future__ import annotations

import struct

import pytest

from converters.ros1_steps import Compiler, Copy
from converters.wire import Buffer
from rce.errors import InvalidRequest
from tests.support.converters.conversions import demo_models


def compiled(text: str, *, to_cdr: bool, **more: str) -> Copy:
    return Compiler(to_cdr=to_cdr).chain(demo_models(Outer=text, **more).message("demo/msg/Outer"))


@pytest.mark.parametrize(("start", "padding"), [(0, 7), (1, 6), (3, 4), (7, 0)])
def test_scalars_are_aligned_wherever_they_begin(start: int, padding: int) -> None:
    packed, parts = struct.pack("<Bd", 5, 1.5), list[Buffer]()
    assert compiled("uint8 a\nfloat64 b", to_cdr=True)(memoryview(packed), 0, parts, start) == (9, start + 9 + padding)
    aligned = b"".join(parts)
    assert aligned == struct.pack(f"<B{padding}xd", 5, 1.5)
    data, parts = memoryview(bytes(start) + aligned), []
    assert compiled("uint8 a\nfloat64 b", to_cdr=False)(data, start, parts, 0) == (len(data), 9)
    assert b"".join(parts) == packed


@pytest.mark.parametrize("text", ["wstring s", "Nothing[] list"])
def test_type_that_ros1_cannot_have_is_refused(text: str) -> None:
    with pytest.raises(InvalidRequest, match="use format cdr"):
        compiled(text, to_cdr=True, Nothing="")
