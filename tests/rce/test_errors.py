"""Errors keep their class, code and fields over the wire."""

import msgspec
import pytest

from rce import errors
from rce.errors import ErrorInfo, NoCapacity, RceError


def crossed(error: RceError) -> RceError:
    packed = msgspec.msgpack.encode(error.info)
    return RceError.from_info(msgspec.msgpack.decode(packed, type=ErrorInfo))


CLASSES = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, RceError)]


@pytest.mark.parametrize("kind", CLASSES)
def test_every_error_comes_out_as_itself(kind: type[RceError]) -> None:
    error = kind("it is wrong", item="addNodes[2]", field="pose.x", limit=5, names=["a"])
    back = crossed(error)
    assert type(back) is kind
    assert (back.info, str(back)) == (error.info, "it is wrong")
    assert (back.item, back.field, back.info.fields) == ("addNodes[2]", "pose.x", {"limit": 5, "names": ["a"]})


def test_codes_are_distinct() -> None:
    codes = [kind.code for kind in CLASSES]
    assert len(set(codes)) == len(codes)


def test_an_unknown_code_is_kept() -> None:
    back = RceError.from_info(ErrorInfo("from_the_future", "new"))
    assert type(back) is RceError
    assert back.info.code == "from_the_future"


def test_the_place_is_added_on_the_way() -> None:
    error = NoCapacity("full", free=0)
    assert error.at("connect[1]") is error
    assert crossed(error).info == ErrorInfo("no_capacity", "full", "connect[1]", "", {"free": 0})


def test_an_error_without_a_code_of_its_own_crosses_as_what_it_is_derived_from() -> None:
    class Special(NoCapacity):
        pass

    assert type(crossed(Special("it is full"))) is NoCapacity
