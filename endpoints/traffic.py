"""What has passed an interface, counted as it passes: a few additions a message, read when somebody asks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from rce.calls.watching import Counts, InterfaceTraffic
from rce.metrics import Family, counted


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

    def of(self, peer: bytes) -> Count:
        count = self.peers.get(peer)
        if count is None:
            count = self.peers[peer] = Count()
        return count

    def part(self, peer: bytes) -> None:
        self._gone.add(self.of(peer))
        del self.peers[peer]

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


class Totals:
    """Of all interfaces of an endpoint, with those that are gone."""

    def __init__(self) -> None:
        self._gone: Counter[tuple[str, str]] = Counter()

    def gone(self, interface: InterfaceTraffic) -> None:
        self._gone += _amounts(interface)

    def families(self, present: Iterable[InterfaceTraffic]) -> list[Family]:
        total = sum(map(_amounts, present), self._gone)

        def of(what: str) -> dict[tuple[str, ...], float]:
            return {(way,): total[what, way] for way in ("sent", "received")}

        return [
            counted("rce_messages", "Messages that interfaces sent and received", ["direction"], of("messages")),
            counted("rce_bytes", "Bytes of payload of these messages", ["direction"], of("bytes")),
            counted("rce_drops", "Messages that were dropped", [], {(): total["drops", ""]}),
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
        }
    )
