"""ROS 2 node that measures round trips to an echo node in its namespace.

Subscribes to `order`, the JSON `{"number", "kind", "size"}`, where the kind is one of `lean.TOPICS` or `service`. For
each order it sends one message of that size and publishes the time until the answer on `report`, the JSON `{"number",
"seconds"}`. The arguments are the kinds to prepare.
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

WIDTH = 640  # pixels of an image; its height follows from the size


class MeasuringNode(LeanNode):
    """Node that measures one round trip at a time."""

    def __init__(self, kinds: list[str]) -> None:
        """Create the topics and the service for messages of these kinds."""
        super().__init__("measure")
        self._started = 0.0
        self._number = 0
        self._reports = self.create_publisher(String, "report", DEPTH)
        self._out = {kind: self.create_publisher(TOPICS[kind], kind, DEPTH) for kind in kinds if kind in TOPICS}
        for kind in self._out:
            self.create_subscription(TOPICS[kind], f"{kind}_back", self._on_answer, DEPTH)
        self._service = self.create_client(SERVICE, "service") if "service" in kinds else None
        self.create_subscription(String, "order", self._on_order, DEPTH)

    def _on_order(self, order: String) -> None:
        fields = json.loads(order.data)
        self._number = fields["number"]
        if fields["kind"] == "service":
            request = service_request(fields["size"])
            assert self._service is not None
            self._started = time.perf_counter()
            self._service.call_async(request).add_done_callback(self._on_answer)
        else:
            value = message(fields["kind"], fields["size"])
            self._started = time.perf_counter()
            self._out[fields["kind"]].publish(value)

    def _on_answer(self, _answer: Any) -> None:
        """Report the round trip. The argument is the message or the future of the response, deserialised by then."""
        seconds = time.perf_counter() - self._started
        self._reports.publish(String(data=json.dumps({"number": self._number, "seconds": seconds})))


@functools.cache
def service_request(size: int) -> SERVICE.Request:
    """Return a request with a string of `size` characters."""
    return SERVICE.Request(load_namespace="x" * size)


@functools.cache
def message(kind: str, size: int) -> String | UInt8MultiArray | Image:
    """Return a message of a kind with `size` bytes of content."""
    if kind == "string":
        return String(data="x" * size)
    data = array("B", bytes(size))
    if kind == "bytes":
        return UInt8MultiArray(data=data)
    return Image(height=size // (3 * WIDTH), width=WIDTH, encoding="rgb8", step=3 * WIDTH, data=data)


if __name__ == "__main__":
    sys.exit(run(MeasuringNode))
