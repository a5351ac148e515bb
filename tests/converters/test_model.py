"""Structs into which JSON is decoded: their defaults, their short forms and their limits."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from msgspec import UNSET

from converters.model import DURATION, IMAGE, MAX_INLINED, TIME, Message
from rce.errors import InvalidRequest
from tests.support.converters.conversions import demo_models


def decoded(message: Message, raw: bytes) -> Any:
    return msgspec.json.decode(raw, type=message.annotation)


def test_names_of_fields_need_not_be_identifiers_of_python() -> None:
    message = demo_models(A="int8 class\nint8 f0\n").message("demo/msg/A")
    value = decoded(message, b'{"class": 1, "f0": 2}')
    assert (value.f0, value.f1) == (1, 2)


def test_missing_fields_get_their_defaults() -> None:
    text = 'int8 a -1\nint16[] b [1, 2]\nfloat64[2] c\nuint8[3] d\nstring e "x"\nbool f\nInner g\nInner[2] h\n'
    models = demo_models(A=text, Inner="float32 x 0.5\n")
    inner = models.message("demo/msg/Inner").default
    expected = (-1, (1, 2), (0, 0), b"\0\0\0", "x", False, inner, (inner, inner))
    values = msgspec.structs.asdict(decoded(models.message("demo/msg/A"), b"{}"))
    assert tuple(values[f"f{i}"] for i in range(len(expected))) == expected


def test_only_times_and_durations_have_a_short_form() -> None:
    models = demo_models()
    assert decoded(models.message(TIME), b'"2026-11-21T10:00:00"') == "2026-11-21T10:00:00"
    assert decoded(models.message(DURATION), b"1.5") == 1.5
    for name, raw in ((TIME, b"1.5"), (DURATION, b'"1.5"'), ("geometry_msgs/msg/Point", b"1.5")):
        with pytest.raises(msgspec.ValidationError):
            decoded(models.message(name), raw)


@pytest.mark.parametrize("raw", [b'{"few": [1]}', b'{"few": [1, 2, 3]}', b'{"most": [1, 2, 3]}'])
def test_lengths_are_checked(raw: bytes) -> None:
    with pytest.raises(msgspec.ValidationError):
        decoded(demo_models(A="int32[2] few\nint32[<=2] most\n").message("demo/msg/A"), raw)


def test_bytes_and_images_may_be_blobs() -> None:
    text = "uint8[] data\nsensor_msgs/Image image\nsensor_msgs/Image[] images\nstring text\n"
    message = demo_models(A=text).message("demo/msg/A")
    assert [member.accepts_blob for member in message.members] == [True, True, True, False]
    value = decoded(message, b'{"data*": "one", "images*": ["two", "three"]}')
    assert (value.f0b, value.f1b, value.f2b) == ("one", UNSET, ["two", "three"])


def test_messages_are_inlined_unless_they_are_repeated_wide_or_images() -> None:
    wide = "".join(f"int8 a{i}\n" for i in range(MAX_INLINED + 1))
    text = "Small one\nSmall[2] two\nWide wide\nsensor_msgs/Image image\n"
    message = demo_models(A=text, Small="int8 a\nint8 b\n", Wide=wide).message("demo/msg/A")
    assert [member.inlined is not None for member in message.members] == [True, False, False, False]
    assert message.width == 2 + 1 + 1 + 1


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("", 1),
        ("int8 a\nfloat64 b\n", 9),
        ("string a\nwstring[3] b\n", 16),
        ("int64[] a\nint64[<=4] b\n", 8),
        ("geometry_msgs/Point[2] a\n", 48),
        ("std_msgs/Empty a\n", 1),
    ],
)
def test_smallest_size_in_cdr(text: str, size: int) -> None:
    assert demo_models(A=text).message("demo/msg/A").smallest == size


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("X x", "contains itself"),
        ("X[] x", "contains itself"),
        ("uint8[2000000] x", "limit is 1048576"),
        ("geometry_msgs/Point[1000000] x", "limit is 1048576"),
        ("uint8[10000000000000000000000] x", "limit is 1048576"),
        ("int8 a 200", r"X\.a has a default"),
        ("int8[2] a [1]", r"X\.a has a default .*1 elements"),
        ("int8 a [1]", r"X\.a has a default .*single number"),
        ("int8[<=2] a [1, 2, 3]", r"X\.a has a default .*3 elements"),
        ("float32 a x", "'x' is not a number"),
        ("geometry_msgs/Point a 5", "single number"),
    ],
)
def test_unusable_definition_is_rejected(text: str, reason: str) -> None:
    with pytest.raises(InvalidRequest, match=reason):
        demo_models(X=text).message("demo/msg/X")


def test_size_and_depth_are_limited() -> None:
    names = [f"N{i}" for i in range(30)]
    doubling = {
        name: f"{inner} a\n{inner} b\n" for name, inner in zip(names, [*names[1:], "std_msgs/Empty"], strict=True)
    }
    models = demo_models(**doubling)
    with pytest.raises(InvalidRequest, match="deep"):
        models.message("demo/msg/N0")
    with pytest.raises(InvalidRequest, match="limit"):
        models.message("demo/msg/N8")
    assert models.message("demo/msg/N18").smallest == 2**12


def test_message_is_built_once() -> None:
    models = demo_models(Outer="Inner a\nInner b\n", Inner="int8 a\n")
    outer = models.message("demo/msg/Outer")
    assert models.message("demo/msg/Outer") is outer
    assert outer.members[0].message is outer.members[1].message is models.message("demo/msg/Inner")


def test_type_that_was_rejected_can_be_asked_for_again() -> None:
    models = demo_models(X="X x")
    for _ in range(2):
        with pytest.raises(InvalidRequest, match="contains itself"):
            models.message("demo/msg/X")
    assert models.message(IMAGE).name == IMAGE
