"""The benchmark's node that publishes at a fixed rate."""

from __future__ import annotations

import struct
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from std_msgs.msg import UInt8MultiArray


def test_messages_are_numbered_and_have_their_time(bench: Any, load: Callable[[str, str], ModuleType]) -> None:
    received = bench.received(UInt8MultiArray, "large")
    bench.add(load("rce_bench", "stream").StreamNode(["large", "200", "1000"]))
    bench.until(lambda: len(received) >= 3)
    heads = [struct.unpack_from("<Qd", bytes(message.data)) for message in received]
    assert {len(message.data) for message in received} == {1000}
    first = heads[0][0]
    assert [number for number, _ in heads] == list(range(first, first + len(heads)))
    assert [time for _, time in heads] == sorted(time for _, time in heads)
