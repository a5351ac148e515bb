"""The parameters of an environment: kept for nodes that start later, as a file of the kind that ROS 2 reads."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path

from rce.calls.endpoints import ParameterSpec
from rce.errors import InvalidRequest
from rce.messages import ParameterValue

Scalar = bool | int | float | str
INT64 = range(-(1 << 63), 1 << 63)


def checked(spec: ParameterSpec) -> ParameterSpec:
    """The spec, with a list of numbers brought to one type. InvalidRequest for what ROS 2 has no parameter type for."""
    value = spec.value
    values = value if isinstance(value, list) else [value]
    kinds = {type(item) for item in values}
    if kinds == {int, float}:
        values, kinds = [float(item) for item in values], {float}
    if len(kinds) != 1:
        reason = "an empty list has no type" if not kinds else "the items of a list must be of one type"
        raise InvalidRequest(f"parameter {spec.name}: {reason}", field="value")
    if any(type(item) is int and item not in INT64 for item in values):
        raise InvalidRequest(f"parameter {spec.name}: an integer needs more than 64 bits", field="value")
    if not spec.name.strip() or any(ord(letter) < 32 for letter in spec.name):
        raise InvalidRequest("a parameter needs a name without control characters", field="name")
    return ParameterSpec(spec.name, values if isinstance(value, list) else value, spec.node)


class Parameters:
    """Those of all nodes and those of single ones, which win."""

    def __init__(self) -> None:
        self.specs: dict[str, ParameterSpec] = {}

    def put(self, spec: ParameterSpec) -> None:
        self.specs[spec.key] = spec

    def drop(self, key: str) -> None:
        self.specs.pop(key, None)

    def of(self, node: str) -> dict[str, ParameterValue]:
        """What a node starts with."""
        of_all = {spec.name: spec.value for spec in self.specs.values() if not spec.node}
        return of_all | {spec.name: spec.value for spec in self.specs.values() if spec.node == node}

    def write(self, node: str, path: Path) -> None:
        """The file for `--params-file`."""
        path.write_text(params_file(self.of(node).items()))


def params_file(parameters: Iterable[tuple[str, ParameterValue]]) -> str:
    """YAML in which every string is quoted, so that ROS 2 takes none for a bool or a number."""
    lines = ["/**:", "  ros__parameters:"]
    lines += [f"    {_scalar(name)}: {_value(value)}" for name, value in parameters]
    return "\n".join(lines if len(lines) > 2 else ["/**:", "  ros__parameters: {}"]) + "\n"


def _value(value: ParameterValue) -> str:
    return f"[{', '.join(map(_scalar, value))}]" if isinstance(value, list) else _scalar(value)


def _scalar(value: Scalar) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return json.dumps(value, ensure_ascii=False)
