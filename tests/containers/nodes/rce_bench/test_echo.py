"""The benchmark's node that sends messages and requests back."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from diagnostic_msgs.srv import AddDiagnostics
from std_msgs.msg import String, UInt8MultiArray


def test_each_message_comes_back_on_its_own_topic(bench: Any, load: Callable[[str, str], ModuleType]) -> None:
    bench.add(load("rce_bench", "echo").EchoNode(["text:string", "data:bytes"]))
    texts, blocks = bench.received(String, "text_back"), bench.received(UInt8MultiArray, "data_back")
    bench.publisher(String, "text").publish(String(data="hello"))
    bench.publisher(UInt8MultiArray, "data").publish(UInt8MultiArray(data=array("B", [1, 2])))
    bench.until(lambda: bool(texts and blocks))
    assert (texts[0].data, list(blocks[0].data)) == ("hello", [1, 2])


def test_service_answers_with_its_request(bench: Any, load: Callable[[str, str], ModuleType]) -> None:
    bench.add(load("rce_bench", "echo").EchoNode(["ask:service"]))
    client = bench.robot.create_client(AddDiagnostics, "ask")
    bench.until(client.service_is_ready)
    answer = client.call_async(AddDiagnostics.Request(load_namespace="hello"))
    bench.until(answer.done)
    assert (answer.result().success, answer.result().message) == (True, "hello")


def test_unknown_kind_is_refused(bench: Any, load: Callable[[str, str], ModuleType]) -> None:
    with pytest.raises(KeyError, match="smoke"):
        load("rce_bench", "echo").EchoNode(["signal:smoke"])
