#!/usr/bin/env python3
"""Terminal in an environment, over the topics PREFIX/input and PREFIX/output (see `rce.protocol.terminal`).

One thread receives from ROS; the main thread does everything else. The process ends with its client: when that hangs
up, has received the exit status, or has not sent anything for a while. The program in the terminal ends with the
process.
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

from rce.protocol import terminal

QOS = QoSProfile(depth=1000)
TICK = 0.25  # seconds between checks of timers
LINGER = 5.0  # seconds that the exit status is sent again after the end of the program


class Line:
    """Topics of the terminal, with a descriptor that is readable when a frame has arrived.

    Attributes:
        woken: That descriptor.
    """

    def __init__(self, node: Node, prefix: str) -> None:
        """Create the topics."""
        self._publisher = node.create_publisher(UInt8MultiArray, f"{prefix}/output", QOS)
        node.create_subscription(UInt8MultiArray, f"{prefix}/input", self._received, QOS)
        self._inbox: deque[bytes] = deque()
        self.woken, self._wake = os.pipe()

    def send(self, frame: bytes) -> None:
        """Send a frame to the client."""
        self._publisher.publish(UInt8MultiArray(data=array("B", frame)))

    def receive(self) -> list[bytes]:
        """Return the frames that have arrived."""
        os.read(self.woken, 65536)
        return [self._inbox.popleft() for _ in range(len(self._inbox))]

    def wake(self) -> None:
        """Make `woken` readable."""
        os.write(self._wake, b".")

    def _received(self, message: UInt8MultiArray) -> None:
        self._inbox.append(message.data.tobytes())
        self.wake()


class Shell:
    """Session with one client.

    Attributes:
        over: Whether the session has ended.
    """

    def __init__(self, line: Line) -> None:
        """Wait for a client on a line."""
        self._line = line
        self._process: Process | None = None
        self._typed = bytearray()  # input that the terminal has not accepted yet
        self._input = terminal.ReceiveStream()
        self._output = terminal.SendStream(line.send)
        self._last_received = time.monotonic()
        self._exit_sent = 0.0
        self.over = False

    def run(self) -> None:
        """Serve the client until the session is over, then end the program."""
        while not self.over:
            self._wait()
            self._output.tick()
            self._check()
        if self._process is not None:
            self._process.end()

    def _wait(self) -> None:
        """Wait for frames, output or room for input, at most TICK, and handle them."""
        process = self._process
        master = process.master if process is not None else -1
        reading = [self._line.woken] + ([master] if master >= 0 and self._output.room else [])
        writing = [master] if master >= 0 and self._typed else []
        readable, writable, _ = select.select(reading, writing, [], TICK)
        if self._line.woken in readable:
            for frame in self._line.receive():
                self._on_frame(frame[:1], frame[1:])
        if process is None:
            return
        if master in readable:
            self._output.write(process.read(min(self._output.room, terminal.CHUNK)))
        if master in writable:
            del self._typed[: process.write(bytes(self._typed))]

    def _on_frame(self, kind: bytes, content: bytes) -> None:
        """Handle a frame of the client."""
        self._last_received = time.monotonic()
        if kind == terminal.OPEN:
            if self._process is None:
                self._process = Process(terminal.Request.decode(content))
            self._line.send(terminal.READY)
        elif kind == terminal.HANG_UP:
            self.over = True
        elif kind == terminal.DATA:
            if len(self._typed) < terminal.WINDOW:  # otherwise it is not acknowledged, and sent again
                self._typed += self._input.receive(content)
            self._line.send(self._input.acknowledgement())
        elif kind == terminal.ACK:
            self._output.acknowledged(content)
        elif kind == terminal.SIZE and self._process is not None:
            self._process.resize(*terminal.read_size(content))

    def _check(self) -> None:
        """End the session if the client is gone; send the exit status if the program has ended."""
        now = time.monotonic()
        process = self._process
        if now - self._last_received > terminal.CLIENT_TIMEOUT:
            self.over = True
        if (
            process is None
            or process.status is None
            or not self._output.all_acknowledged
            or now - self._exit_sent < TICK
        ):
            return
        self._exit_sent = now
        self._line.send(terminal.exit_frame(process.status, self._output.end))
        self.over = self.over or now - process.ended > LINGER


def spin(node: Node) -> None:
    """Receive from ROS until it shuts down."""
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        return


def main() -> int:
    """Run the terminal with the prefix from the command line; return the exit status."""
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
