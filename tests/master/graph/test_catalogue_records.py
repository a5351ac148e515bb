"""Records of the catalogue: their keys, and which services are shared."""

from __future__ import annotations

import msgspec
import pytest

from master.graph.catalogue_records import Instance, Offer, Port, Tally, Use
from master.graph.records import EnvironmentOptions, Record, ref

OFFER = Offer("ann/echo", "1", "", [Port("say", "takes", "std_msgs/String", "say")], [], {}, EnvironmentOptions(), [],
              1, 0, 1, 0, 300.0, ["*"])  # fmt: skip


@pytest.mark.parametrize(
    ("record", "key"),
    [
        (OFFER, "ann/echo"),
        (Instance("bob/echo", "ann/echo", "1"), "bob/echo"),
        (Use("bob/r2d2", "mine", "ann/echo", "bob/echo"), "bob/r2d2/mine"),
        (Tally("ann/echo", "bob", 3), "ann/echo bob"),
    ],
)
def test_record_has_a_key_and_survives_storage(record: Record, key: str) -> None:
    assert record.key == key
    assert ref(record) == (type(record).__name__.lower(), key)
    assert msgspec.json.decode(msgspec.json.encode(record), type=type(record)) == record


@pytest.mark.parametrize(("robots", "shared"), [(1, False), (2, True)])
def test_service_for_several_robots_is_shared(robots: int, shared: bool) -> None:
    assert msgspec.structs.replace(OFFER, robots=robots).is_shared is shared
