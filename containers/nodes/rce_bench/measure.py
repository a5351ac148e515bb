"""Takes round trips to an echo node in its namespace, one whenever it is ordered, and reports how long each took.

In: `order`, the JSON `{"number", "kind", "size"}`, whose kind is one of `lean.TOPICS` or `service`. Out: `report`, the
JSON `{"number", "seconds"}`. Topics and services are made when they are first needed.
"""

from __future__ import annotations

import functools
import json
import sys
import time
from array import array
from typing import Any

from lean import DEPTH, SERVICE, TOPICS, LeanNode, run
from sensor_msgs.msg import Image
from std_msgs.msg import String, UInt8MultiArray

WIDTH = 640  # of images, whose height follows from their size


class MeasuringNode(LeanNode):
    def __init__(self, kinds: list[str]) -> None:
        super().__init__("measure")
        self._began = 0.0
        self._number = 0
        self._reports = self.create_publisher(String, "report", DEPTH)
        self._out = {kind: self.create_publisher(TOPICS[kind], kind, DEPTH) for kind in kinds if kind in TOPICS}
        for kind in self._out:
            self.create_subscription(TOPICS[kind], f"{kind}_back", self._answered, DEPTH)
        self._service = self.create_client(SERVICE, "service") if "service" in kinds else None
        self.create_subscription(String, "order", self._ordered, DEPTH)

    def _ordered(self, order: String) -> None:
        words = json.loads(order.data)
        self._number = words["number"]
        if words["kind"] == "service":
            request = service_request(words["size"])
            assert self._service is not None
            self._began = time.perf_counter()
            self._service.call_async(request).add_done_callback(self._answered)
        else:
            value = message(words["kind"], words["size"])
            self._began = time.perf_counter()
            self._out[words["kind"]].publish(value)

    def _answered(self, _answer: Any) -> None:
        """Called with the message, or the future that holds the response; both are deserialized by then."""
        seconds = time.perf_counter() - self._began
        self._reports.publish(String(data=json.dumps({"number": self._number, "seconds": seconds})))


@functools.cache
def service_request(size: int) -> SERVICE.Request:
    return SERVICE.Request(load_namespace="x" * size)


@functools.cache
def message(kind: str, size: int) -> String | UInt8MultiArray | Image:
    if kind == "string":
        return String(data="x" * size)
    data = array("B", bytes(size))
    if kind == "bytes":
        return UInt8MultiArray(data=data)
    return Image(height=size // (3 * WIDTH), width=WIDTH, encoding="rgb8", step=3 * WIDTH, data=data)


if __name__ == "__main__":
    sys.exit(run(MeasuringNode))
