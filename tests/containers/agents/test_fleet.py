"""Nodes with agents: what they offer together, and what an engine passes on to the agents."""

from __future__ import annotations

from typing import Any
from unittest.mock import Mock

from msgspec import Struct

from containers.agents.fleet import FleetEngine, NodeFleet
from containers.limits import Size
from rce.protocol.slots import MB


class Node(Struct, frozen=True):
    usable: bool = True
    features: frozenset[str] = frozenset()
    gpus: int = 0
    size: Size = Size(2, 1000 * MB)


def fleet(**nodes: Node) -> NodeFleet[Node]:
    made: NodeFleet[Node] = NodeFleet(["lab"])
    made.nodes = nodes
    return made


def test_fleet_offers_what_its_usable_nodes_have() -> None:
    found = fleet(
        one=Node(features=frozenset({"arm"}), gpus=1, size=Size(8, 500 * MB)),
        two=Node(gpus=2, size=Size(2, 4000 * MB)),
        gone=Node(usable=False, features=frozenset({"laser"}), gpus=8, size=Size(64, 64_000 * MB)),
    )
    assert set(found.usable) == {"one", "two"}
    assert found.features == {"lab", "arm"}
    assert found.gpus == 3
    assert found.largest == Size(8, 4000 * MB), "of any one node each"


def test_fleet_without_usable_nodes_counts_this_machine() -> None:
    found = fleet(gone=Node(usable=False))
    assert (found.features, found.gpus, found.largest) == ({"lab"}, 0, Size.here())


def _agents_only() -> Any:
    """Return an engine without the parts that a subclass adds."""
    kind: Any = type("AgentsOnly", (FleetEngine,), dict.fromkeys(FleetEngine.__abstractmethods__))
    return object.__new__(kind)


def test_engine_reaches_its_agents_and_knows_the_relays_of_present_nodes_only() -> None:
    engine = _agents_only()
    engine._fleet = fleet(one=Node())
    engine._fleet.agents = agents = Mock(relays={"one": "10.0.0.1:9", "left": "10.0.0.2:9"})
    assert engine.relays == {"one": "10.0.0.1:9"}
    engine.set_relays(["relay:10.0.0.3:9"])
    engine.set_master("tcp:b:8080")
    engine.set_removed_machines({"beta": 1.5})
    agents.set_relays.assert_called_once_with(["relay:10.0.0.3:9"])
    agents.set_master.assert_called_once_with("tcp:b:8080")
    agents.set_removed_machines.assert_called_once_with({"beta": 1.5})
