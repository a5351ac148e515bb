"""Codecs of smaller messages, in each form that robots receive."""

from __future__ import annotations

import json
from typing import Any

import cbor2
import msgspec
import pytest

from converters import TypeRegistry, Wire
from converters.cdr import CDR, CdrCodec
from converters.dialect import Dialect
from converters.reduction import ALL, Projector, ReducedCodec
from converters.ros1 import Ros1Codec
from rce.errors import InvalidRequest
from rce.protocol.messages import Decimation
from rce.protocol.names import parse_type

REGISTRY = TypeRegistry()
SCAN = parse_type("sensor_msgs/LaserScan")
PLAIN = REGISTRY.message(SCAN)
VALUE: dict[str, Any] = {"header": {"frame_id": "laser"}, "angle_increment": 0.5, "ranges": [1.0, 2.0, 3.0]}
MESSAGE = PLAIN.encode(Wire(False, json.dumps(VALUE).encode(), {}))


def blob(wire: Wire) -> bytes:
    (data,) = wire.blobs.values()
    return bytes(data)


def test_json_has_the_wanted_fields_of_the_decimated_message() -> None:
    codec = ReducedCodec(PLAIN, PLAIN, ["ranges", "angle_increment"], Decimation(step=2))
    assert json.loads(bytes(codec.decode(MESSAGE).raw)) == {"angle_increment": 1.0, "ranges": [1.0, 3.0]}


@pytest.mark.parametrize("dialect", ["original", "rosbridge"])
def test_other_dialects_of_json_have_the_wanted_fields(dialect: Dialect) -> None:
    form = REGISTRY.message(SCAN, dialect=dialect)
    codec = ReducedCodec(form, form, ["header.frame_id"], ALL)
    assert json.loads(bytes(codec.decode(MESSAGE).raw)) == {"header": {"frame_id": "laser"}}


def test_cbor_has_the_wanted_fields() -> None:
    form = REGISTRY.message(SCAN, dialect="cbor")
    codec = ReducedCodec(form, form, ["header.frame_id", "angle_increment"], ALL)
    assert cbor2.loads(blob(codec.decode(MESSAGE))) == {"header": {"frame_id": "laser"}, "angle_increment": 0.5}


def test_part_of_a_stamp_keeps_its_name_in_the_dialect_of_the_original() -> None:
    form = REGISTRY.message(SCAN, dialect="original")
    codec = ReducedCodec(form, form, ["header.stamp.sec"], ALL)
    assert json.loads(bytes(codec.decode(MESSAGE).raw)) == {"header": {"stamp": {"sec": 0}}}


def test_cdr_is_of_the_same_type_with_defaults_for_the_rest() -> None:
    form = CdrCodec(msgspec.structs.replace(PLAIN.recipe, converter=CDR))
    codec = ReducedCodec(PLAIN, form, ["angle_increment"], ALL)
    got = json.loads(bytes(PLAIN.decode(blob(codec.decode(MESSAGE))).raw))
    assert (got["angle_increment"], got["ranges"], got["header"]["frame_id"]) == (0.5, [], "")


def test_ros1_is_made_of_the_smaller_message() -> None:
    form = Ros1Codec(PLAIN)
    small = ReducedCodec(PLAIN, form, ["header"], ALL).decode(MESSAGE)
    assert blob(small) == blob(form.decode(Projector(PLAIN.message, ["header"])(MESSAGE)))
    assert len(blob(small)) < len(blob(form.decode(MESSAGE)))


def test_recipe_names_what_is_left_and_speed_is_that_of_the_slower_part() -> None:
    codec = ReducedCodec(PLAIN, PLAIN, ["ranges"], Decimation(step=3))
    assert codec.recipe == msgspec.structs.replace(PLAIN.recipe, fields=("ranges",), decimate=Decimation(step=3))
    assert codec.decodes_fast(MESSAGE)
    assert not codec.decodes_fast(bytes(10_000_000))
    assert codec.encodes_fast(Wire(False, b"{}", {}))
    assert codec.encode(Wire(False, json.dumps(VALUE).encode(), {})) == MESSAGE


def test_unknown_fields_and_types_without_parts_are_refused() -> None:
    with pytest.raises(InvalidRequest, match="did you mean ranges"):
        ReducedCodec(PLAIN, PLAIN, ["range"], ALL)
    with pytest.raises(InvalidRequest, match="use step"):
        ReducedCodec(PLAIN, PLAIN, [], Decimation(size=(2, 2)))
