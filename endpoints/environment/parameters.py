"""Parameters of an environment, which nodes read at their start from a ROS 2 parameter file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rce.control.calls.endpoints import ParameterSpec
from rce.errors import InvalidRequest
from rce.protocol.messages import ParameterValue

Scalar = bool | int | float | str
RosValue = Scalar | list[bool] | list[int] | list[float] | list[str]
"""Value that ROS 2 has a parameter type for."""


def validate(spec: ParameterSpec) -> ParameterSpec:
    """Return the spec; raise InvalidRequest if its name is not valid."""
    if not spec.name.strip() or any(ord(letter) < 32 for letter in spec.name):
        raise InvalidRequest("the name of a parameter must not be empty or contain control characters", field="name")
    return spec


def ros_form(value: ParameterValue) -> RosValue:
    """Return a parameter's value as nodes get it.

    ROS 1 had lists of mixed types, empty and nested ones, and maps. ROS 2 has no types for them: nodes get them as YAML
    text. Mixed integers and floats are floats.
    """
    if not isinstance(value, list | dict):
        return value
    if isinstance(value, list):
        kinds = {type(item) for item in value}
        if kinds == {int, float}:
            return [float(item) for item in value]
        if len(kinds) == 1 and kinds < {bool, int, float, str}:
            return value
    return yaml_text(value)


# Characters that YAML does not allow in a file, and line breaks of YAML that are none of JSON (YAML 1.1, section 5).
_NOT_IN_YAML = re.compile("[\x7f-\x9f\u2028\u2029\ufeff\ufffe\uffff]")


def yaml_text(value: Any) -> str:
    """Return a value as YAML with every string quoted, so that it is not read as a bool or a number."""
    if isinstance(value, list):
        return f"[{', '.join(map(yaml_text, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{yaml_text(key)}: {yaml_text(item)}' for key, item in value.items())}}}"
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0 else "-.inf"
    return _NOT_IN_YAML.sub(lambda found: f"\\u{ord(found[0]):04x}", json.dumps(value, ensure_ascii=False))


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
    """Return the content of a ROS 2 parameter file."""
    lines = ["/**:", "  ros__parameters:"]
    lines += [f"    {yaml_text(name)}: {yaml_text(ros_form(value))}" for name, value in parameters]
    return "\n".join(lines if len(lines) > 2 else ["/**:", "  ros__parameters: {}"]) + "\n"
