"""What has passed an interface, counted as it passes: a few additions a message, read when somebody asks."""

from __future__ import annotations

from rce.calls import Counts, InterfaceTraffic


class Count:
    """Messages and bytes of payload, and messages that were dropped."""

    __slots__ = ("bytes", "drops", "messages")

    def __init__(self) -> None:
        self.messages = self.bytes = self.drops = 0

    def passed(self, size: int) -> None:
        self.messages += 1
        self.bytes += size

    def add(self, other: Count) -> None:
        self.messages += other.messages
        self.bytes += other.bytes
        self.drops += other.drops

    @property
    def counts(self) -> Counts:
        return Counts(self.messages, self.bytes, self.drops)


class InterfaceCounts:
    """`sent` to all peers; `peers` has what came from each, with the drops of that and of what was for it."""

    __slots__ = ("_gone", "peers", "sent")

    def __init__(self) -> None:
        self.sent = Count()
        self.peers: dict[bytes, Count] = {}
        self._gone = Count()

    def join(self, peer: bytes) -> None:
        self.peers.setdefault(peer, Count())

    def part(self, peer: bytes) -> None:
        self._gone.add(self.peers.pop(peer))

    def traffic(self, dropped: int) -> InterfaceTraffic:
        """`dropped` are all drops of the interface, whosever they were."""
        received = Count()
        received.add(self._gone)
        for count in self.peers.values():
            received.add(count)
        return InterfaceTraffic(
            Counts(self.sent.messages, self.sent.bytes, dropped),
            Counts(received.messages, received.bytes),
            {peer.hex(): count.counts for peer, count in self.peers.items()},
        )
