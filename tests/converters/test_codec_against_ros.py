"""CDR of the codecs compared with that of rclpy, for every type of the common packages that is installed here."""

from __future__ import annotations

import base64
import importlib
import json
import math
import random
from array import array
from typing import Any, cast

import numpy as np
import pytest

from converters import Codec, TypeRegistry, Wire
from converters.model import Models
from converters.types import common_definitions
from rce.protocol.names import TypeName
from tests.support.converters.random_json import Json, sample

serialization = pytest.importorskip("rclpy.serialization", reason="ROS 2 (rclpy) is not installed")

pytestmark = pytest.mark.ros

MODELS = Models(lambda name: common_definitions()[name])


def ros_class(name: str) -> type | None:
    package, kind, plain = name.split("/")
    plain, _, part = plain.partition("_") if kind == "srv" else (plain, "", "")
    try:
        found: Any = getattr(importlib.import_module(f"{package}.{kind}"), plain)
    except (ImportError, AttributeError):
        return None
    return cast("type", getattr(found, part) if part else found)


CLASSES = {name: ros for name in sorted(common_definitions()) if (ros := ros_class(name))}


def codec(registry: TypeRegistry, name: str) -> Codec:
    package, kind, plain = name.split("/")
    if kind == "msg":
        return registry.message(TypeName(package, plain), "json")
    plain, _, part = plain.partition("_")
    service = registry.service(TypeName(package, plain), "json")
    return service.request if part == "Request" else service.response


def test_installed_packages_are_covered() -> None:
    assert {name.split("/")[0] for name in CLASSES} >= {
        "std_msgs",
        "geometry_msgs",
        "sensor_msgs",
        "nav_msgs",
        "std_srvs",
    }
    assert len(CLASSES) > 150


def plain(value: Any) -> Json:
    """Convert an rclpy message to the JSON that a codec produces for it."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, (bytes, array, np.ndarray)):
        values = list(value)
        return base64.b64encode(bytes(values)).decode() if is_bytes(value) else [plain(one) for one in values]
    if isinstance(value, (list, tuple)):
        as_bytes = bool(value) and isinstance(value[0], bytes)  # byte[] is a list of bytes of length 1
        return base64.b64encode(b"".join(value)).decode() if as_bytes else [plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return {"inf": "Infinity", "-inf": "-Infinity", "nan": "NaN"}[str(value)]
    return cast("Json", value)


def is_bytes(values: Any) -> bool:
    return (
        isinstance(values, bytes) or getattr(values, "typecode", None) == "B" or getattr(values, "dtype", None) == "u1"
    )


def same(ours: Json, theirs: Json) -> bool:
    """Compare JSON; rclpy represents a single `byte` as bytes and an empty byte[] as an empty list."""
    if isinstance(ours, dict) and isinstance(theirs, dict):
        return ours.keys() == theirs.keys() and all(same(ours[key], theirs[key]) for key in ours)
    if isinstance(ours, list) and isinstance(theirs, list):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    if isinstance(ours, int) and isinstance(theirs, str):
        return base64.b64encode(bytes([ours])).decode() == theirs
    return ours == theirs or (ours == "" and theirs == [])


@pytest.mark.parametrize("name", CLASSES)
def test_random_messages_round_trip_through_ros(registry: TypeRegistry, name: str) -> None:
    ours, rng = codec(registry, name), random.Random(name)
    for _ in range(8):
        value = sample(MODELS.message(name), rng)
        cdr = ours.encode(Wire(False, json.dumps(value).encode(), {}))
        ros = serialization.deserialize_message(cdr, CLASSES[name])
        assert same(value, plain(ros))
        theirs = serialization.serialize_message(ros)  # may have trailing padding
        assert json.loads(bytes(ours.decode(theirs).raw)) == json.loads(bytes(ours.decode(cdr).raw)) == value


@pytest.mark.parametrize("name", CLASSES)
def test_defaults_equal_those_of_ros(registry: TypeRegistry, name: str) -> None:
    ours = codec(registry, name)
    cdr = ours.encode(Wire(False, b"{}", {}))
    theirs = serialization.serialize_message(CLASSES[name]())
    assert json.loads(bytes(ours.decode(cdr).raw)) == json.loads(bytes(ours.decode(theirs).raw))
