"""The benchmark's node that sends numbers back and prints them."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from std_msgs.msg import String


def test_numbers_come_back_and_are_printed(
    bench: Any, load: Callable[[str, str], ModuleType], capsys: pytest.CaptureFixture[str]
) -> None:
    bench.add(load("rce_bench", "numbered").NumberedNode([]))
    back = bench.received(String, "numbers_back")
    numbers = bench.publisher(String, "numbers")
    for number in range(100):
        numbers.publish(String(data=str(number)))
    bench.until(lambda: len(back) == 100)
    assert [message.data for message in back] == [str(number) for number in range(100)]
    assert capsys.readouterr().out.split() == [str(number) for number in range(100)]
