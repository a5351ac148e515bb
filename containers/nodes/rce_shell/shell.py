#!/usr/bin/env python3
"""A terminal inside an environment, over the topics PREFIX/input and PREFIX/output (see `rce.terminal`).

One thread takes from ROS, the main thread does all the rest. It ends with its client: when that hangs up, has the exit
status, or has not been heard of for a while; and what runs in the terminal ends with it.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import threading
import time
from array import array
from collections import deque
from pathlib import Path

import rclpy
from process import Process
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from std_msgs.msg import UInt8MultiArray

from rce import terminal

QOS = QoSProfile(depth=1000)
TICK = 0.25  # seconds
LINGER = 5.0  # for which a client may fetch the exit status


class Line:
    """The topics, with a descriptor that is readable when something has come."""

    def __init__(self, node: Node, prefix: str) -> None:
        self._publisher = node.create_publisher(UInt8MultiArray, f"{prefix}/output", QOS)
        node.create_subscription(UInt8MultiArray, f"{prefix}/input", self._received, QOS)
        self._inbox: deque[bytes] = deque()
        self.woken, self._wake = os.pipe()

    def send(self, frame: bytes) -> None:
        self._publisher.publish(UInt8MultiArray(data=array("B", frame)))

    def take(self) -> list[bytes]:
        os.read(self.woken, 65536)
        return [self._inbox.popleft() for _ in range(len(self._inbox))]

    def wake(self) -> None:
        os.write(self._wake, b".")

    def _received(self, message: UInt8MultiArray) -> None:
        self._inbox.append(message.data.tobytes())
        self.wake()


class Shell:
    """The conversation with one client."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self._process: Process | None = None
        self._typed = bytearray()  # that the terminal has not taken yet
        self._input = terminal.Incoming()
        self._output = terminal.Outgoing(line.send)
        self._heard = time.monotonic()
        self._exit_said = 0.0
        self.over = False

    def run(self) -> None:
        while not self.over:
            self._wait()
            self._output.tick()
            self._look()
        if self._process is not None:
            self._process.end()

    def _wait(self) -> None:
        """Until something can be done, or TICK is over."""
        process = self._process
        master = process.master if process is not None else -1
        reading = [self._line.woken] + ([master] if master >= 0 and self._output.room else [])
        writing = [master] if master >= 0 and self._typed else []
        readable, writable, _ = select.select(reading, writing, [], TICK)
        if self._line.woken in readable:
            for frame in self._line.take():
                self._received(frame[:1], frame[1:])
        if process is None:
            return
        if master in readable:
            self._output.put(process.read(min(self._output.room, terminal.PIECE)))
        if master in writable:
            del self._typed[: process.write(bytes(self._typed))]

    def _received(self, kind: bytes, content: bytes) -> None:
        self._heard = time.monotonic()
        if kind == terminal.OPEN:
            if self._process is None:
                self._process = Process(terminal.Request.decode(content))
            self._line.send(terminal.READY)
        elif kind == terminal.BYE:
            self.over = True
        elif kind == terminal.DATA:
            if len(self._typed) < terminal.WINDOW:  # else it comes again
                self._typed += self._input.take(content)
            self._line.send(self._input.acknowledgement())
        elif kind == terminal.TAKEN:
            self._output.taken(content)
        elif kind == terminal.SIZE and self._process is not None:
            self._process.resize(*terminal.read_size(content))

    def _look(self) -> None:
        now = time.monotonic()
        process = self._process
        if now - self._heard > terminal.GONE:
            self.over = True
        if process is None or process.status is None or not self._output.all_taken or now - self._exit_said < TICK:
            return
        self._exit_said = now
        self._line.send(terminal.exit_frame(process.status, self._output.end))
        self.over = self.over or now - process.ended > LINGER


def spin(node: Node) -> None:
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        return


def main() -> int:
    prefix = remove_ros_args(sys.argv)[1]
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = Node(Path(prefix).name, start_parameter_services=False, enable_rosout=False)
    line = Line(node, prefix)
    shell = Shell(line)

    def stop(*_: object) -> None:
        shell.over = True
        line.wake()

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    thread = threading.Thread(target=spin, args=[node])
    thread.start()
    try:
        shell.run()
    finally:
        rclpy.try_shutdown()
        thread.join()
    return 0


if __name__ == "__main__":
    sys.exit(main())
