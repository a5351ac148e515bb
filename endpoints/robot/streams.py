"""Streams of a robot: numbered messages, each of which is taken once.

A robot whose socket broke cannot know which of its last messages have arrived, and sends them again.
"""

from __future__ import annotations

from rce.errors import NotConnected, RceError
from rce.protocol.messages import DataMessage

MAX_STREAMS = 100  # of one robot; that which was silent longest is forgotten
MAX_MISSED = 1000  # messages of a stream


class Stream:
    """Numbers of one stream."""

    __slots__ = ("last", "missed", "taking")

    def __init__(self) -> None:
        self.last = -1  # the highest that was taken
        self.taking: set[int] = set()  # that are being converted
        self.missed: list[int] = []  # that had no peer, while later ones may have had one


class Streams:
    """Streams of one robot, which outlast its sessions.

    Attributes:
        incarnation: Incarnation of the Robot endpoint.
    """

    def __init__(self, incarnation: str) -> None:
        self.incarnation = incarnation
        self._streams: dict[str, Stream] = {}  # the one that was silent longest first

    @property
    def unused(self) -> bool:
        """True if the robot has sent no numbered message."""
        return not self._streams

    def taken(self, message: DataMessage) -> bool:
        """Return whether a message was taken before."""
        stream = self._streams.get(message.stream)
        return stream is not None and message.number <= stream.last and message.number not in stream.missed

    def begin(self, message: DataMessage) -> bool:
        """Begin to take a message; return False if it is being taken already."""
        stream = self._streams[message.stream] = self._streams.pop(message.stream, Stream())
        if len(self._streams) > MAX_STREAMS:
            del self._streams[next(iter(self._streams))]
        if message.number in stream.taking:
            return False
        stream.taking.add(message.number)
        return True

    def end(self, message: DataMessage, error: RceError | None) -> None:
        """Remember that a message was taken, also with an error; without a peer it may come again."""
        stream = self._streams.get(message.stream)
        if stream is None:  # forgotten meanwhile
            return
        stream.taking.discard(message.number)
        if isinstance(error, NotConnected):
            stream.missed = [*stream.missed[-MAX_MISSED:], message.number]
            return
        stream.last = max(stream.last, message.number)
        if message.number in stream.missed:
            stream.missed.remove(message.number)
