"""Single messages followed hop by hop."""

from __future__ import annotations

from msgspec import Struct

from rce.calls.watching import Hop


class HopView(Struct, frozen=True):
    """A message at a hop. Times are those of the machine `host`: clocks of two machines may differ."""

    interface: str  # endpointTag/interfaceTag
    hop: Hop
    time: float
    host: str


class MessageTrace(Struct, frozen=True):
    """A message that passed, with its hops in their order; a request of a service has those of its answer too."""

    message: str  # its id
    source: str  # the interface that it came from
    hops: list[HopView]


class Traced(Struct, frozen=True):
    """The messages that passed meanwhile."""

    messages: list[MessageTrace]
