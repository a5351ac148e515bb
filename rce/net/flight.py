"""Bytes in flight on a TCP connection, held to what the line carries.

A sender that fills the buffers of the kernel and of a slow line delays every later message by seconds. So no more is
written than the line carries in a round trip and a short queue: its rate is the greatest of the last seconds, its
round-trip time the least, as in BBR (Cardwell et al. 2016, "BBR: Congestion-based congestion control"). What waits in
the kernel, because its congestion window is full, is one part at most. The rest stays in the outbox, where small
messages overtake large ones. Where the kernel gives no measurements, nothing is held.
"""

from __future__ import annotations

import ipaddress
import math
import socket
import struct
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

QUEUE = 0.03  # seconds that bytes may wait on the line, besides its round trip
GAIN = 1.25  # of the bytes that the line carries in a round trip, so that a faster line is noticed
LEAST, UNKNOWN = 16 * 1024, 64 * 1024  # bytes in flight: at least, and while the rate is not known
WINDOW = 10.0  # seconds in which the greatest rate counts
PART_TIME = 0.01  # seconds that a part of a large message may take of the line
LEAST_PART, MOST_PART = 8 * 1024, 256 * 1024  # bytes
STALLED, STALLED_TRIPS = 2.0, 4  # seconds and round trips without an acknowledgement after which a line is dead
SHORTEST_WAIT, LONGEST_WAIT = 0.0005, 0.02  # seconds between two looks

# struct tcp_info (linux/tcp.h): offsets, and the size up to the last field that is used
_MSS, _UNACKED, _SACKED, _LOST, _RETRANSMITTED = 16, 24, 28, 32, 36
_ACKED, _NOT_SENT, _MIN_RTT, _RATE = 120, 144, 148, 160
_SIZE = 168


class Sample(NamedTuple):
    """State of a connection.

    Attributes:
        in_flight: Bytes that were sent and are neither acknowledged nor lost.
        unsent: Bytes that wait in the kernel.
        round_trip: Least round-trip time, in seconds.
        rate: Bytes per second that were delivered recently.
        acknowledged: Bytes that were acknowledged so far.
        outstanding: Whether bytes were sent that are not acknowledged.
    """

    in_flight: int
    unsent: int
    round_trip: float
    rate: float
    acknowledged: int = 0
    outstanding: bool = False


def flight_of(sock: Any) -> Flight:
    """Return what holds back a connection; nothing does if it is none of TCP, or if its peer is on this machine."""
    try:
        measured = hasattr(socket, "TCP_INFO") and not ipaddress.ip_address(sock.getpeername()[0]).is_loopback
    except (OSError, ValueError, IndexError, AttributeError):  # closed already, another kind of socket, or none
        measured = False
    return Flight(partial(_sample, sock) if measured else lambda: None)


def _sample(sock: Any) -> Sample | None:
    """Return the state of a TCP connection; None if the kernel does not tell it."""
    option = socket.TCP_INFO
    try:
        info = sock.getsockopt(socket.IPPROTO_TCP, option, _SIZE)
    except OSError:
        return None
    if len(info) < _SIZE:
        return None

    def number(offset: int) -> int:
        value: int = struct.unpack_from("=I", info, offset)[0]
        return value

    segments = number(_UNACKED) - number(_SACKED) - number(_LOST) + number(_RETRANSMITTED)
    (rate,), (acknowledged,) = (struct.unpack_from("=Q", info, offset) for offset in (_RATE, _ACKED))
    waiting = (segments * number(_MSS), number(_NOT_SENT))
    return Sample(*waiting, number(_MIN_RTT) / 1e6, rate, acknowledged, number(_UNACKED) > 0)


class Flight:
    """Decides when a connection has room for more, how large the parts of messages should be, and when it is dead."""

    def __init__(self, read: Callable[[], Sample | None], now: Callable[[], float] = time.monotonic) -> None:
        """Hold back what `read`, which returns the state of the connection, shows to be too much."""
        self._read = read
        self._now = now
        self._room = 0.0  # bytes that may be written before the next look at the connection
        self._rates: list[tuple[float, float]] = []  # time and rate, of which each is less than the one before
        self.part = MOST_PART
        self._acknowledged = 0
        self._progress = now()  # time at which bytes were acknowledged, or none was outstanding

    def stalled(self) -> bool:
        """Return whether nothing is acknowledged for so long that the line must be dead.

        It must be called several times a second. The kernel alone notices a dead line after minutes, and sends again
        after pauses that double.
        """
        sample, now = self._read(), self._now()
        if sample is None or not sample.outstanding or sample.acknowledged != self._acknowledged:
            self._acknowledged, self._progress = sample.acknowledged if sample is not None else 0, now
            return False
        return now - self._progress > STALLED + STALLED_TRIPS * sample.round_trip

    def wait(self, written: int = 0) -> float:
        """Return 0 if more may be written, else the seconds until the next call; `part` has the size of parts.

        Small messages that fit into the room of the last measurement cost no system call.

        Args:
            written: Bytes that were written since the last call.
        """
        self._room -= written
        if self._room > 0:
            return 0.0
        sample = self._read()
        if sample is None:
            self._room = math.inf
            return 0.0
        rate = self._greatest(sample.rate)
        if not rate:
            self._room = UNKNOWN - sample.in_flight - sample.unsent
            return 0.0 if self._room > 0 else SHORTEST_WAIT
        self.part = min(MOST_PART, max(LEAST_PART, int(rate * PART_TIME)))
        limit = rate * max(GAIN * sample.round_trip, sample.round_trip + QUEUE)
        self._room = min(max(limit, LEAST) - sample.in_flight, self.part - sample.unsent)
        return 0.0 if self._room > 0 else min(LONGEST_WAIT, max(SHORTEST_WAIT, -self._room / rate))

    def _greatest(self, rate: float) -> float:
        """Return the greatest rate of the last seconds, with a new one."""
        now, rates = self._now(), self._rates
        while rates and rates[-1][1] <= rate:
            rates.pop()
        rates.append((now, rate))
        while rates[0][0] < now - WINDOW:
            del rates[0]
        return rates[0][1]
