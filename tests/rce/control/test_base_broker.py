"""Perspective Broker as both sides of a control connection use it."""

from __future__ import annotations

from typing import Any

import pytest
from twisted.spread import pb

from rce.control.base_broker import BaseBroker


@pytest.mark.parametrize(
    "value", [(), (b"page",), (b"one", b"two"), {}, (b"one", "text"), [b"one"], {"x": 1}, 7], ids=str
)
def test_values_are_those_of_twisted(value: Any) -> None:
    """Calls and answers take a short way to the same bytes."""
    ours, twisted = BaseBroker(), pb.Broker()  # type: ignore[no-untyped-call]
    line = ours.serialize(value)
    assert line == twisted.serialize(value)  # type: ignore[no-untyped-call]
    assert ours.unserialize(line) == twisted.unserialize(line) == value  # type: ignore[no-untyped-call]
