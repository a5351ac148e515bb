"""The benchmark's node that floods a topic with numbered strings."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from std_msgs.msg import String


def test_strings_have_rising_numbers_and_the_size(bench: Any, load: Callable[[str, str], ModuleType]) -> None:
    flood = bench.received(String, "flood")
    bench.add(load("rce_bench", "flood").FloodNode(["flood", "25"]))
    bench.until(lambda: len(flood) >= 100)
    texts = [message.data for message in flood[:100]]
    numbers = [int(text[:10]) for text in texts]
    assert numbers == sorted(set(numbers))
    assert {text[10:] for text in texts} == {"x" * 15}
