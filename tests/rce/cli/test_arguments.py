"""Arguments of command lines."""

from __future__ import annotations

from typing import Any

import pytest

from rce.cli.arguments import argument


@pytest.mark.parametrize(("flag", "positional"), [("name", True), ("--json", False), ("-n", False)])
def test_argument_without_dash_is_positional(flag: str, positional: bool) -> None:
    assert argument(flag).positional is positional


@pytest.mark.parametrize(
    ("action", "takes_value"), [(None, True), ("store", True), ("append", True), ("store_true", False)]
)
def test_option_takes_a_value_unless_it_is_a_flag(action: str | None, takes_value: bool) -> None:
    options: dict[str, Any] = {} if action is None else {"action": action}
    assert argument("--option", **options).takes_value is takes_value
