"""Messages of watchers and to them."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from rce.api.views.live import Deltas, Event, Greeting


def test_parts_without_a_value_are_not_sent() -> None:
    assert msgspec.to_builtins(Deltas(3, drop={"robots": ["ann/r1"]})) == {"seq": 3, "drop": {"robots": ["ann/r1"]}}
    event = msgspec.to_builtins(Event("7", 5.0, "robot.left", "ann", "ann/r1"))
    assert event == {"id": "7", "time": 5.0, "type": "robot.left", "user": "ann", "object": "ann/r1"}


def test_exit_status_of_zero_is_sent() -> None:
    assert msgspec.to_builtins(Event("7", 5.0, "node.died", "ann", "ann/brain/n", status=0))["status"] == 0


@pytest.mark.parametrize("greeting", [{}, {"key": 5}, {"key": "k", "kinds": ["robot"]}, {"key": "k", "users": "*"}])
def test_wrong_greeting_is_refused(greeting: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(greeting, Greeting)


def test_greeting_without_kinds_is_for_the_own_user() -> None:
    assert msgspec.convert({"key": "k"}, Greeting) == Greeting("k", "", [])
