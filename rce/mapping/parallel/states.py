"""Parts and results of units as bytes: .npz without pickled objects."""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rce.mapping.files.arrays import pack_arrays, unpack_arrays
from rce.mapping.grid import OccupancyGrid
from rce.mapping.history import History
from rce.mapping.pose_graph.graph import Edge, PoseGraph, edges_state, restore_edges
from rce.mapping.pose_graph.loops import Candidate
from rce.mapping.pose_graph.team_graph import Comparison
from rce.mapping.pose_graph.teams import Overlap
from rce.mapping.state import Reader, State, flatten


@dataclass(frozen=True, slots=True)
class PartMap:
    """Map of a recording or of a piece of it.

    Attributes:
        graph: Pose graph, whose first node is at the origin.
        history: Pose of each scan relative to a node.
    """

    graph: PoseGraph
    history: History

    def pack(self) -> bytes:
        """Return the part as bytes."""
        return pack_state({"graph": self.graph.state(), "history": self.history.state()})

    @classmethod
    def unpack(cls, data: bytes) -> PartMap:
        """Return a packed part.

        Raises:
            InvalidRequest: The bytes are no part.
        """
        saved = unpack_state(data)
        part = cls(PoseGraph(), History())
        part.graph.restore(saved.part("graph"))
        part.history.restore(saved.part("history"), len(part.graph.nodes))
        return part


@dataclass(frozen=True, slots=True)
class SeedMap:
    """Map by the mapper `particle`.

    Attributes:
        grid: The map.
        trajectory: (n, 4) stamp, x, y, theta of each scan, map frame.
    """

    grid: OccupancyGrid
    trajectory: NDArray[np.float64]

    @property
    def occupied(self) -> int:
        """Number of occupied cells, which is the larger the more walls of a recording appear twice.

        Filatov et al., 2D SLAM Quality Evaluation Methods, 2017.
        """
        return int((self.grid.cells > 50).sum())

    def pack(self) -> bytes:
        """Return the map as bytes."""
        grid = self.grid
        return pack_state(
            {
                "cells": grid.cells,
                "frame": np.array([grid.resolution, grid.x, grid.y], np.float64),
                "trajectory": self.trajectory,
            }
        )

    @classmethod
    def unpack(cls, data: bytes) -> SeedMap:
        """Return a packed map.

        Raises:
            InvalidRequest: The bytes are no map.
        """
        saved = unpack_state(data)
        resolution, x, y = saved.array("frame", np.float64, 3).tolist()
        grid = OccupancyGrid(saved.array("cells", np.int8, None, None), resolution, x, y)
        return cls(grid, saved.array("trajectory", np.float64, None, 4))


def pack_overlaps(overlaps: Sequence[Overlap]) -> bytes:
    """Return overlaps as bytes: edges from the nearest node of the other part to the place."""
    return pack_state(edges_state([Edge(each.near, each.node, each.motion, each.information) for each in overlaps]))


def unpack_overlaps(data: bytes, own: PoseGraph, other: PoseGraph) -> list[Overlap]:
    """Return packed overlaps of places of one graph in another.

    Raises:
        InvalidRequest: The bytes are no overlaps of these graphs.
    """
    saved = unpack_state(data)
    edges = restore_edges(saved, max(len(own.nodes), len(other.nodes)))
    if any(edge.second >= len(own.nodes) or edge.first >= len(other.nodes) for edge in edges):
        raise saved.invalid("ends", "are not nodes of the parts")
    return [Overlap(edge.second, edge.first, edge.motion, edge.information) for edge in edges]


def pack_comparisons(comparisons: Sequence[Comparison], names: Sequence[str]) -> bytes:
    """Return comparisons of the places of a team as bytes; `names` are the parts of the team in its order."""
    ties = [tie for each in comparisons for tie in each.ties]
    return pack_state(
        {
            "candidates": edges_state([c.edge() for each in comparisons for c in each.candidates]),
            "ties": edges_state([tie for _, tie in ties]),
            "robots": np.array([names.index(name) for name, _ in ties], np.int64),
        }
    )


def unpack_comparisons(data: bytes, nodes: Sequence[int], names: Sequence[str], count: int) -> list[Comparison]:
    """Return packed comparisons of these nodes of a team.

    Args:
        data: The bytes.
        nodes: Numbers of the nodes.
        names: Parts of the team in its order.
        count: Number of nodes of the team.

    Raises:
        InvalidRequest: The bytes are no comparisons of these nodes.
    """
    saved = unpack_state(data)
    candidates: dict[int, list[Candidate]] = defaultdict(list)
    ties: dict[int, list[tuple[str, Edge]]] = defaultdict(list)
    for edge in restore_edges(saved.part("candidates"), count):
        candidates[edge.second].append(Candidate(edge.second, edge.first, edge.motion, edge.information))
    edges = restore_edges(saved.part("ties"), count)
    for edge, robot in zip(edges, saved.indices("robots", len(names), len(edges)).tolist(), strict=True):
        ties[edge.second].append((names[robot], edge))
    if not {*candidates, *ties} <= {*nodes}:
        raise saved.invalid("candidates", "are of other nodes")
    return [Comparison(node, candidates[node], ties[node]) for node in nodes]


def pack_state(state: State) -> bytes:
    """Return a state as bytes. Points hardly compress, and a worker is faster without."""
    return pack_arrays(dict(flatten(state)), compress=False)


def unpack_state(data: bytes) -> Reader:
    """Return a reader of a packed state.

    Raises:
        InvalidRequest: The bytes are no state.
    """
    return Reader(unpack_arrays(io.BytesIO(data), "the message of a mapping worker", "a state of a map"))
