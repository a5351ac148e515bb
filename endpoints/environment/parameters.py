"""Parameters of an environment, which nodes read at their start from a ROS 2 parameter file."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path

from rce.control.calls.endpoints import ParameterSpec
from rce.errors import InvalidRequest
from rce.protocol.messages import ParameterValue

Scalar = bool | int | float | str
INT64 = range(-(1 << 63), 1 << 63)


def validate(spec: ParameterSpec) -> ParameterSpec:
    """Return the spec, with a list of mixed numbers converted to floats.

    Raises:
        InvalidRequest: ROS 2 has no parameter type for the value, or the name is not valid.
    """
    value = spec.value
    values = value if isinstance(value, list) else [value]
    kinds = {type(item) for item in values}
    if kinds == {int, float}:
        values, kinds = [float(item) for item in values], {float}
    if len(kinds) != 1:
        reason = "an empty list has no type" if not kinds else "all items of a list must be of the same type"
        raise InvalidRequest(f"parameter {spec.name}: {reason}", field="value")
    if any(type(item) is int and item not in INT64 for item in values):
        raise InvalidRequest(f"parameter {spec.name}: an integer does not fit into 64 bits", field="value")
    if not spec.name.strip() or any(ord(letter) < 32 for letter in spec.name):
        raise InvalidRequest("the name of a parameter must not be empty or contain control characters", field="name")
    return ParameterSpec(spec.name, values if isinstance(value, list) else value, spec.node)


class Parameters:
    """Parameters of all nodes and of single nodes; the latter take precedence."""

    def __init__(self) -> None:
        self.specs: dict[str, ParameterSpec] = {}

    def put(self, spec: ParameterSpec) -> None:
        """Set a parameter."""
        self.specs[spec.key] = spec

    def drop(self, key: str) -> None:
        """Remove a parameter, if it is set."""
        self.specs.pop(key, None)

    def of(self, node: str) -> dict[str, ParameterValue]:
        """Return the parameters of the node with this tag."""
        of_all = {spec.name: spec.value for spec in self.specs.values() if not spec.node}
        return of_all | {spec.name: spec.value for spec in self.specs.values() if spec.node == node}

    def write(self, node: str, path: Path) -> None:
        """Write the parameters of a node to a file for `--params-file`."""
        path.write_text(params_file(self.of(node).items()))


def params_file(parameters: Iterable[tuple[str, ParameterValue]]) -> str:
    """Return YAML with every string quoted, so that ROS 2 does not read it as a bool or a number."""
    lines = ["/**:", "  ros__parameters:"]
    lines += [f"    {_scalar(name)}: {_value(value)}" for name, value in parameters]
    return "\n".join(lines if len(lines) > 2 else ["/**:", "  ros__parameters: {}"]) + "\n"


def _value(value: ParameterValue) -> str:
    return f"[{', '.join(map(_scalar, value))}]" if isinstance(value, list) else _scalar(value)


def _scalar(value: Scalar) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return json.dumps(value, ensure_ascii=False)
