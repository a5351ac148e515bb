"""Nodes with agents, and an engine that reaches its environments through them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Generic, Protocol, TypeVar

from containers.agents.connections import Agents
from containers.engine import Engine
from containers.limits import Size


class FleetNode(Protocol):
    """A machine on which an agent runs."""

    @property
    def usable(self) -> bool:
        """True if environments on it are reachable."""

    @property
    def features(self) -> frozenset[str]:
        """Special features that it has beside those of every node."""

    @property
    def gpus(self) -> int:
        """Number of its GPUs."""

    @property
    def size(self) -> Size:
        """Its cores and memory."""


N = TypeVar("N", bound=FleetNode)


class NodeFleet(Generic[N]):
    """Nodes with their agents.

    Attributes:
        nodes: All nodes, by id.
        agents: Their agents, once the fleet is open.
        common_features: Special features of every node.
    """

    def __init__(self, features: Collection[str]) -> None:
        """Prepare a fleet without nodes; `features` are those of every node."""
        self.nodes: dict[str, N] = {}
        self.agents: Agents
        self.common_features = frozenset(features)

    @property
    def usable(self) -> dict[str, N]:
        """The nodes on which environments are reachable, by id."""
        return {id: node for id, node in self.nodes.items() if node.usable}

    @property
    def features(self) -> frozenset[str]:
        """All special features that any usable node has."""
        return self.common_features.union(*(node.features for node in self.usable.values()))

    @property
    def gpus(self) -> int:
        """The number of GPUs on all usable nodes."""
        return sum(node.gpus for node in self.usable.values())

    @property
    def largest(self) -> Size:
        """The most cores and the most memory that any one node has."""
        sizes = [node.size for node in self.usable.values()] or [Size.here()]
        return Size(max(size.cores for size in sizes), max(size.memory for size in sizes))


class FleetEngine(Engine):
    """An engine whose agents relay data and the Master's control connections; a subclass makes the fleet."""

    _fleet: NodeFleet[Any]

    @property
    def relays(self) -> dict[str, str]:
        """Data relays of the nodes, also of those whose agent is away for a moment."""
        return {node: relay for node, relay in self._fleet.agents.relays.items() if node in self._fleet.nodes}

    def set_relays(self, relays: Collection[str]) -> None:
        """Send the agents the data relays of other machines."""
        self._fleet.agents.set_relays(relays)

    def set_master(self, master: str) -> None:
        """Tell the agents which Master leads."""
        self._fleet.agents.set_master(master)

    def set_removed_machines(self, machines: Mapping[str, float]) -> None:
        """Send the agents when machines were removed."""
        self._fleet.agents.set_removed_machines(machines)
