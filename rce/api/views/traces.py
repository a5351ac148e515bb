"""Types of message traces."""

from __future__ import annotations

from msgspec import Struct

from rce.control.calls.watching import Hop


class HopView(Struct, frozen=True):
    """Message at one hop. The time is that of the machine `host`; clocks of different machines may differ."""

    interface: str  # endpointTag/interfaceTag
    hop: Hop
    time: float
    host: str


class MessageTrace(Struct, frozen=True):
    """Message with its hops in their order; for a service request, the hops of the response are included."""

    message: str  # id
    source: str  # interface from which it came
    hops: list[HopView]


class Traced(Struct, frozen=True):
    """Messages that passed during the trace."""

    messages: list[MessageTrace]
