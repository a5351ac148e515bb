"""The benchmark's node that time-stamps velocity commands."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from geometry_msgs.msg import Twist
from std_msgs.msg import Float64


def test_arrival_has_the_time_of_the_monotonic_clock(bench: Any, load: Callable[[str, str], ModuleType]) -> None:
    bench.add(load("rce_bench", "commands").CommandNode([]))
    arrivals, commands = bench.received(Float64, "arrival"), bench.publisher(Twist, "command")
    before = time.monotonic()
    commands.publish(Twist())
    bench.until(lambda: bool(arrivals))
    assert before <= arrivals[0].data <= time.monotonic()
