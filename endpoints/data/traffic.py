"""Traffic counters of interfaces.

Counting costs a few additions a message; sums are computed when somebody reads them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from rce.control.calls.watching import Counts, InterfaceTraffic
from rce.process.metrics import Family, counter_family


class TrafficCount:
    """Number of messages, of their payload bytes, and of dropped messages."""

    __slots__ = ("bytes", "drops", "messages")

    def __init__(self) -> None:
        self.messages = self.bytes = self.drops = 0

    def count(self, size: int) -> None:
        """Count one message with a payload of `size` bytes."""
        self.messages += 1
        self.bytes += size

    def add(self, other: TrafficCount) -> None:
        """Add the numbers of another count."""
        self.messages += other.messages
        self.bytes += other.bytes
        self.drops += other.drops

    @property
    def counts(self) -> Counts:
        """The numbers as they travel to the Master."""
        return Counts(self.messages, self.bytes, self.drops)


class InterfaceCounter:
    """Counters of one interface.

    Attributes:
        sent: Messages to all peers.
        peers: Messages from each present peer, and the drops in both directions.
    """

    __slots__ = ("_former_peers", "peers", "sent")

    def __init__(self) -> None:
        self.sent = TrafficCount()
        self.peers: dict[bytes, TrafficCount] = {}
        self._former_peers = TrafficCount()

    def of(self, peer: bytes) -> TrafficCount:
        """Return the counter of a peer, created at its first use."""
        count = self.peers.get(peer)
        if count is None:
            count = self.peers[peer] = TrafficCount()
        return count

    def remove_peer(self, peer: bytes) -> None:
        """Stop counting a peer; its messages stay in the sum of received messages."""
        self._former_peers.add(self.of(peer))
        del self.peers[peer]

    def snapshot(self, dropped: int, unheard: int = 0) -> InterfaceTraffic:
        """Return the present numbers, with the numbers of all dropped and unheard messages of the interface."""
        received = TrafficCount()
        received.add(self._former_peers)
        for count in self.peers.values():
            received.add(count)
        return InterfaceTraffic(
            Counts(self.sent.messages, self.sent.bytes, dropped),
            Counts(received.messages, received.bytes),
            {peer.hex(): count.counts for peer, count in self.peers.items()},
            unheard,
        )


class TrafficTotals:
    """Sums over all interfaces of an endpoint, including removed ones."""

    def __init__(self) -> None:
        self._removed: Counter[tuple[str, str]] = Counter()

    def add_removed(self, interface: InterfaceTraffic) -> None:
        """Keep the final numbers of an interface that is removed."""
        self._removed += _amounts(interface)

    def families(self, present: Iterable[InterfaceTraffic]) -> list[Family]:
        """Return the sums as metrics, given the numbers of the present interfaces."""
        total = sum(map(_amounts, present), self._removed)

        def by_direction(unit: str) -> dict[tuple[str, ...], float]:
            return {(direction,): total[unit, direction] for direction in ("sent", "received")}

        return [
            counter_family(
                "rce_messages", "Messages that interfaces sent and received", ["direction"], by_direction("messages")
            ),
            counter_family("rce_bytes", "Payload bytes of these messages", ["direction"], by_direction("bytes")),
            counter_family("rce_drops", "Messages that were dropped", [], {(): total["drops", ""]}),
            counter_family("rce_unheard", "Messages to topics without subscribers", [], {(): total["unheard", ""]}),
        ]


def _amounts(interface: InterfaceTraffic) -> Counter[tuple[str, str]]:
    sent, received = interface.sent, interface.received
    return Counter(
        {
            ("messages", "sent"): sent.messages,
            ("messages", "received"): received.messages,
            ("bytes", "sent"): sent.bytes,
            ("bytes", "received"): received.bytes,
            ("drops", ""): sent.drops,
            ("unheard", ""): interface.unheard,
        }
    )
