"""Errors keep their class, code and fields when they cross process boundaries."""

import msgspec
import pytest

from rce import errors
from rce.errors import DiskFull, ErrorInfo, NoCapacity, RceError


def round_trip(error: RceError) -> RceError:
    packed = msgspec.msgpack.encode(error.info)
    return RceError.from_info(msgspec.msgpack.decode(packed, type=ErrorInfo))


CLASSES = [
    kind
    for kind in vars(errors).values()
    if isinstance(kind, type) and issubclass(kind, RceError) and kind is not DiskFull  # to others it is Unavailable
]


@pytest.mark.parametrize("kind", CLASSES)
def test_every_error_keeps_its_class_and_fields(kind: type[RceError]) -> None:
    error = kind("it is wrong", item="addNodes[2]", field="pose.x", limit=5, names=["a"])
    back = round_trip(error)
    assert type(back) is kind
    assert (back.info, str(back)) == (error.info, "it is wrong")
    assert (back.item, back.field, back.info.fields) == ("addNodes[2]", "pose.x", {"limit": 5, "names": ["a"]})


def test_codes_are_distinct() -> None:
    codes = [kind.code for kind in CLASSES]
    assert len(set(codes)) == len(codes)


def test_unknown_code_is_kept() -> None:
    back = RceError.from_info(ErrorInfo("from_the_future", "new"))
    assert type(back) is RceError
    assert back.info.code == "from_the_future"


def test_item_can_be_added_later() -> None:
    error = NoCapacity("full", free=0)
    assert error.with_item("connect[1]") is error
    assert round_trip(error).info == ErrorInfo("no_capacity", "full", "connect[1]", "", {"free": 0})


def test_subclass_without_a_code_of_its_own_crosses_as_its_base_class() -> None:
    class Special(NoCapacity):
        pass

    assert type(round_trip(Special("it is full"))) is NoCapacity


def test_error_of_no_kind_is_none_of_a_subclass_without_a_code() -> None:
    class Own(RceError):
        def __init__(self, reason: int, message: str) -> None:
            super().__init__(message)

    assert type(RceError.from_info(Own(1, "no").info)) is RceError
