"""The parameters that nodes start with."""

import math

import pytest
import yaml

from endpoints.environment.parameters import Parameters, checked, params_file
from rce.calls.endpoints import ParameterSpec
from rce.errors import InvalidRequest
from rce.messages import ParameterValue

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
    "deep.name": 1,
}


def test_file_has_every_type() -> None:
    assert yaml.safe_load(params_file(VALUES.items())) == {"/**": {"ros__parameters": VALUES}}


def test_file_without_parameters() -> None:
    assert yaml.safe_load(params_file({}.items())) == {"/**": {"ros__parameters": {}}}


def test_file_has_what_numbers_there_are() -> None:
    read = yaml.safe_load(params_file({"inf": -math.inf, "nan": math.nan}.items()))["/**"]["ros__parameters"]
    assert read["inf"] == -math.inf
    assert math.isnan(read["nan"])


def test_those_of_a_node_win() -> None:
    parameters = Parameters()
    for spec in (ParameterSpec("a", 1), ParameterSpec("b", 1), ParameterSpec("a", 2, "x"), ParameterSpec("c", 3, "y")):
        parameters.put(spec)
    assert parameters.of("x") == {"a": 2, "b": 1}
    parameters.drop(ParameterSpec("a", 2, "x").key)
    assert parameters.of("x") == {"a": 1, "b": 1}


def test_numbers_of_a_list_become_one_type() -> None:
    assert checked(ParameterSpec("a", [1, 2.5])).value == [1.0, 2.5]


@pytest.mark.parametrize("value", [[1, "a"], [True, 1], [], 1 << 63, [0, -(1 << 63) - 1]])
def test_what_ros_has_no_type_for(value: ParameterValue) -> None:
    with pytest.raises(InvalidRequest, match="parameter a"):
        checked(ParameterSpec("a", value))
