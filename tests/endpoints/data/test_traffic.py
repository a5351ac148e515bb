"""Traffic of interfaces, and its sums as metrics."""

from __future__ import annotations

from endpoints.data.traffic import InterfaceCounter, TrafficTotals
from rce.control.calls.watching import Counts, InterfaceTraffic

ANN, BOB = b"a" * 16, b"b" * 16


def sums(totals: TrafficTotals, *present: InterfaceTraffic) -> dict[tuple[str, ...], float]:
    """Return the values of all metrics by name and labels."""
    return {
        (family.name, *sample.labels): sample.value for family in totals.families(present) for sample in family.samples
    }


def test_messages_are_counted_for_each_peer() -> None:
    counter = InterfaceCounter()
    counter.sent.count(100)
    counter.of(ANN).count(10)
    counter.of(ANN).count(5)
    counter.of(BOB).count(1)
    counter.of(BOB).drops += 2
    assert counter.snapshot(7) == InterfaceTraffic(
        Counts(1, 100, 7), Counts(3, 16), {ANN.hex(): Counts(2, 15), BOB.hex(): Counts(1, 1, 2)}
    )


def test_messages_of_former_peers_stay_counted() -> None:
    counter = InterfaceCounter()
    counter.of(ANN).count(10)
    counter.remove_peer(ANN)
    counter.remove_peer(BOB)  # which has sent nothing
    counter.of(ANN).count(1)  # it has come back
    assert counter.snapshot(0) == InterfaceTraffic(Counts(), Counts(2, 11), {ANN.hex(): Counts(1, 1)})


def test_sums_include_removed_interfaces() -> None:
    totals = TrafficTotals()
    totals.add_removed(InterfaceTraffic(Counts(1, 10, 3), Counts(2, 20)))
    totals.add_removed(InterfaceTraffic(Counts(1, 1), Counts(), unheard=4))
    present = InterfaceTraffic(Counts(5, 50, 1), Counts(6, 60))
    for _ in range(2):  # reading changes nothing
        assert sums(totals, present, present) == {
            ("rce_messages", "sent"): 12,
            ("rce_messages", "received"): 14,
            ("rce_bytes", "sent"): 111,
            ("rce_bytes", "received"): 140,
            ("rce_drops",): 5,
            ("rce_unheard",): 4,
        }


def test_endpoint_without_traffic_has_sums_of_zero() -> None:
    assert set(sums(TrafficTotals()).values()) == {0}
