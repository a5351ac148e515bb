"""Conditions."""

from __future__ import annotations

import pytest

from endpoints.environment.launch.interpreter import conditions as c
from endpoints.environment.launch.interpreter.context import Context, LaunchError


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        (c.IfCondition("true"), True),
        (c.IfCondition("0"), False),
        (c.UnlessCondition("False"), True),
        (c.LaunchConfigurationEquals("a", "1"), True),
        (c.LaunchConfigurationEquals("a", "2"), False),
        (c.LaunchConfigurationEquals("b", None), True),
        (c.LaunchConfigurationNotEquals("a", "2"), True),
        (c.LaunchConfigurationNotEquals("a", "1"), False),
    ],
)
def test_condition(condition: c.Condition, holds: bool) -> None:
    assert condition.evaluate(Context(arguments={"a": "1"})) is holds


def test_text_without_truth_is_an_error() -> None:
    with pytest.raises(LaunchError, match="neither true nor false"):
        c.IfCondition("").evaluate(Context())
