"""ROS 2 node `worker`: executes units of work of a parallel mapping job.

It subscribes to `units` and publishes `answers`, both `std_msgs/UInt8MultiArray` with the messages of
`rce.mapping.parallel.units`. It works in a thread of its own and gives a sign of life each second.
"""

from __future__ import annotations

import queue
import threading
from array import array

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

from rce.errors import InvalidRequest, RceError
from rce.mapping.parallel.units import Answer, Busy, Failed, Unit, decode_unit, encode
from rce.mapping.parallel.worker import Worker

KEPT = QoSProfile(depth=4, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
INTERVAL = 1.0  # seconds between signs of life


class WorkerNode(Node):
    """Node around a `Worker`."""

    def __init__(self) -> None:
        """Create the topics and start to work."""
        super().__init__("worker")
        self._worker = Worker()
        self._units: queue.SimpleQueue[Unit] = queue.SimpleQueue()
        self._current, self._scans = -1, 0  # number of the unit at work, and scans of it that are mapped
        self._answer: Answer | None = None  # the last one
        self._answers = self.create_publisher(UInt8MultiArray, "answers", KEPT)
        self.create_subscription(UInt8MultiArray, "units", self._on_unit, KEPT)
        self.create_timer(INTERVAL, self._publish_sign_of_life)
        self._publish_sign_of_life()
        threading.Thread(target=self._work, name="work", daemon=True).start()

    def _on_unit(self, message: UInt8MultiArray) -> None:
        """Queue a unit. One that came before is a repetition, since its answer may be lost."""
        try:
            unit = decode_unit(bytes(message.data))
        except InvalidRequest as error:
            self.get_logger().error(f"message on units: {error}")
            return
        if unit.number > self._current:
            self._current, self._scans = unit.number, 0
            self._units.put(unit)
        elif self._answer is not None and self._answer.number == unit.number:
            self._publish(self._answer)

    def _work(self) -> None:
        while True:
            unit = self._units.get()
            try:
                answer = self._worker.execute(unit, self._report)
            except Exception as error:  # noqa: BLE001  # a bug must not end the thread without an answer
                self.get_logger().error(f"unit {unit.number}: {type(error).__name__}: {error}")
                answer = Answer(unit.number, Failed(RceError(f"a mapping worker failed: {error}").info))
            self._answer = answer
            self._publish(answer)

    def _report(self, scans: int) -> None:
        self._scans = scans

    def _publish_sign_of_life(self) -> None:
        self._publish(Answer(self._current, Busy(self._scans)))

    def _publish(self, answer: Answer) -> None:
        self._answers.publish(UInt8MultiArray(data=array("B", encode(answer))))
