"""Messages between the robot of the benchmark and an operator in the cloud.

Each message carries the time at which it was sent; robot and operator run on one machine and share its monotonic clock.
"""

from __future__ import annotations

import struct
import time

from msgspec import Struct

from rce.protocol.messages import Delivery

TYPE = "std_msgs/String"
SERVICE, SERVICE_TYPE, SERVICE_PERIOD = "lamp", "std_srvs/SetBool", 0.5
ROBOT, OPERATOR = "robot", "operator"
PLAIN_MARGIN = 4 / 3  # of binary data as base64 in JSON

_CDR = b"\0\1\0\0"  # the encapsulation header of little-endian CDR (RTPS 2.5, 10.2)
_LENGTH = struct.Struct("<I")
_STAMP = 16  # characters


class StreamSpec(Struct, frozen=True):
    """A stream of messages.

    Attributes:
        name: Tag of its interfaces.
        up: True from the robot to the operator.
        size: Bytes of a message.
        period: Seconds between two messages.
        delivery: How they cross the line with the client library.
    """

    name: str
    up: bool
    size: int
    period: float
    delivery: Delivery


STREAMS = (
    StreamSpec("camera", True, 40_000, 1 / 30, Delivery("low", maxAge=0.5)),  # VGA as JPEG, 9.6 Mbit/s
    StreamSpec("scan", True, 3_000, 1 / 10, Delivery("normal", maxAge=1.0)),
    StreamSpec("velocity", False, 100, 1 / 20, Delivery("high", maxAge=0.5)),
)


PERIODS = {stream.name: stream.period for stream in STREAMS} | {SERVICE: SERVICE_PERIOD}


def text(size: int) -> str:
    """Return the content of a message that is sent now."""
    return f"{time.monotonic():<{_STAMP}.6f}".ljust(size, "x")


def cdr(size: int) -> bytes:
    """Return a message that is sent now, as CDR."""
    content = text(size).encode()
    return _CDR + _LENGTH.pack(len(content) + 1) + content + b"\0"


def sent_at(content: str) -> float:
    """Return the time at which a message was sent, from its content."""
    return float(content[:_STAMP])


def sent_at_of_cdr(message: bytes) -> float:
    """Return the time at which a message was sent, from its CDR."""
    begin = len(_CDR) + _LENGTH.size
    return float(message[begin : begin + _STAMP])


class Arrivals(Struct):
    """Messages of a stream that arrived: when each was sent and when it arrived, in the order of arrival."""

    times: list[tuple[float, float]] = []

    def add(self, sent_at: float) -> None:
        """Note that a message arrives."""
        self.times.append((sent_at, time.monotonic()))

    def add_cdr(self, message: bytes) -> None:
        """Note that a message arrives as CDR."""
        self.add(sent_at_of_cdr(message))
