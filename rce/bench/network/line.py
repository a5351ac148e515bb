"""Model of a line between a robot and the cloud. It does no I/O: the caller gives the time.

Delay and jitter keep the order of packets, as radio links do. Losses come in bursts, by the two-state model of Gilbert
(1960), "Capacity of a burst-noise channel". A packet waits in a queue of limited length until the rate permits it.
"""

from __future__ import annotations

from functools import partial
from random import Random

from msgspec import Struct

BURST = 3.0  # packets, the mean length of a burst of losses
MBIT = 1e6


class Way(Struct, frozen=True):
    """One direction of a line.

    Attributes:
        delay: Seconds from one end to the other, without queueing.
        jitter: Seconds by which the delay varies in both directions, uniformly.
        loss: Fraction of the packets that are lost.
        rate: Bits per second.
        queue: Seconds that a packet may wait for its turn; others are dropped at once.
    """

    delay: float
    jitter: float
    loss: float
    rate: float
    queue: float = 0.5


class Outage(Struct, frozen=True):
    """Time in which nothing passes in either direction: seconds after the start, and its length."""

    start: float
    length: float


class Profile(Struct, frozen=True):
    """A line: from the robot (`up`), to the robot (`down`), its outages, and changes of the robot's address.

    Attributes:
        up: From the robot to the cloud.
        down: From the cloud to the robot.
        outages: Outages, in their order.
        moves: Seconds after the start at which the robot gets another address. Packets from and to the last one are
            lost from then on.
    """

    up: Way
    down: Way
    outages: tuple[Outage, ...] = ()
    moves: tuple[float, ...] = ()

    @property
    def round_trip(self) -> float:
        """Seconds of a round trip without queueing and jitter."""
        return self.up.delay + self.down.delay


def _line(round_trip: float, jitter: float, loss: float, up: float, down: float, queue: float) -> Profile:
    """Return a profile; half of the round trip and of its jitter belong to each way."""
    way = partial(Way, round_trip / 2, jitter / 2, loss, queue=queue)
    return Profile(way(rate=up * MBIT), way(rate=down * MBIT))


_LTE = _line(0.060, 0.025, 0.01, 8, 20, 0.5)
PROFILES = {
    "wifi-edge": _line(0.020, 0.015, 0.03, 20, 20, 0.25),
    "lte": _LTE,
    "satellite": _line(0.600, 0.0, 0.0, 2, 2, 1.0),
    "tunnel": Profile(_LTE.up, _LTE.down, outages=(Outage(15.0, 20.0), Outage(65.0, 30.0))),
    "address-change": Profile(_LTE.up, _LTE.down, moves=(15.0, 35.0)),
}


class Line:
    """One direction of a line, with its state.

    Attributes:
        up: False while nothing passes.
    """

    def __init__(self, way: Way, random: Random) -> None:
        self.up = True
        self._way = way
        self._random = random
        self._free = 0.0  # time at which the sender of the line has sent all that waits
        self._last = 0.0  # time at which the last packet arrives
        self._losing = False

    def arrival(self, now: float, size: int) -> float | None:
        """Return when a packet arrives that is sent now, or None if it is lost.

        Args:
            now: Time in seconds.
            size: Number of bytes.
        """
        way = self._way
        begin = max(now, self._free)
        if not self.up or begin - now > way.queue:
            return None
        self._free = begin + size * 8 / way.rate
        if self._lost():
            return None
        delay = way.delay + self._random.uniform(-way.jitter, way.jitter)
        self._last = max(self._last, self._free + delay)
        return self._last

    def _lost(self) -> bool:
        """Move between the state that loses packets and the one that does not; return the new one."""
        if self._way.loss == 0:
            return False
        leave = 1 / BURST
        enter = leave * self._way.loss / (1 - self._way.loss)
        self._losing = self._random.random() < (1 - leave if self._losing else enter)
        return self._losing
