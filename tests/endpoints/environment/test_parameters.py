"""Parameters of nodes at their start."""

import math

import pytest
import yaml

from endpoints.environment.parameters import Parameters, params_file, ros_form, validate
from rce.control.calls.endpoints import ParameterSpec
from rce.errors import InvalidRequest
from rce.protocol.messages import ParameterValue

VALUES: dict[str, ParameterValue] = {
    "flag": True,
    "count": -5,
    "ratio": 0.5,
    "word": "yes",
    "text": 'a "b"\n: é ☃',
    "flags": [True, False],
    "counts": [1, 2],
    "ratios": [1.0, 2.5],
    "words": ["1", "null"],
    "characters": ["\ufffe", "a\x85b\u2028c\u2029d", "\ufeff", "\x9f", "\U0001f600"],
    "deep.name": 1,
}


def test_file_supports_every_type() -> None:
    assert yaml.safe_load(params_file(VALUES.items())) == {"/**": {"ros__parameters": VALUES}}


def test_file_without_parameters() -> None:
    assert yaml.safe_load(params_file({}.items())) == {"/**": {"ros__parameters": {}}}


def test_file_supports_infinity_and_nan() -> None:
    read = yaml.safe_load(params_file({"inf": -math.inf, "nan": math.nan}.items()))["/**"]["ros__parameters"]
    assert read["inf"] == -math.inf
    assert math.isnan(read["nan"])


def test_parameters_of_single_node_take_precedence() -> None:
    parameters = Parameters()
    for spec in (ParameterSpec("a", 1), ParameterSpec("b", 1), ParameterSpec("a", 2, "x"), ParameterSpec("c", 3, "y")):
        parameters.put(spec)
    assert parameters.of("x") == {"a": 2, "b": 1}
    parameters.drop(ParameterSpec("a", 2, "x").key)
    assert parameters.of("x") == {"a": 1, "b": 1}


def test_mixed_numbers_of_list_become_floats() -> None:
    assert ros_form([1, 2.5]) == [1.0, 2.5]


@pytest.mark.parametrize(
    "value", [["one", 2, "three", "true"], [True, 1], [], [[1, 2], []], [None], {}, {"gains": [0.5, {"p": "1"}]}]
)
def test_value_without_ros_type_is_yaml_text(value: ParameterValue) -> None:
    assert yaml.safe_load(str(ros_form(value))) == value
    text = yaml.safe_load(params_file([("a", value)]))["/**"]["ros__parameters"]["a"]
    assert yaml.safe_load(text) == value


def test_name_with_control_character_is_rejected() -> None:
    with pytest.raises(InvalidRequest, match="name"):
        validate(ParameterSpec("a\nb", 1))
