"""The benchmark's node that measures round trips."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs the extra `ros`")

from std_msgs.msg import String

Load = Callable[[str, str], ModuleType]
KINDS = ["string", "bytes", "image", "service"]


def test_each_order_is_answered_with_its_number_and_time(bench: Any, load: Load) -> None:
    bench.add(load("rce_bench", "echo").EchoNode([f"{kind}:{kind}" for kind in KINDS]))
    node = load("rce_bench", "measure").MeasuringNode(KINDS)
    bench.add(node)
    reports, orders = bench.received(String, "report"), bench.publisher(String, "order")
    bench.until(lambda: all(each.get_subscription_count() for each in node._out.values()))
    bench.until(node._service.service_is_ready)
    for number, kind in enumerate(KINDS, 1):
        orders.publish(String(data=json.dumps({"number": number, "kind": kind, "size": 5760})))
        bench.until(lambda number=number: len(reports) == number)
    found = [json.loads(report.data) for report in reports]
    assert [report["number"] for report in found] == [1, 2, 3, 4]
    assert all(0 < report["seconds"] < 60 for report in found)


def test_messages_have_the_size_of_the_order(load: Load) -> None:
    measure = load("rce_bench", "measure")
    assert len(measure.message("string", 7).data) == len(measure.message("bytes", 7).data) == 7
    assert len(measure.service_request(7).load_namespace) == 7
    image = measure.message("image", 3 * 640 * 480)
    assert (image.width, image.height, image.step, len(image.data)) == (640, 480, 1920, 3 * 640 * 480)
