"""Mapper of several robots that build one map together, from unknown relative starts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import Estimate, MapperSettings
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.pose_graph.overlaps import WholeMap, place_points
from rce.mapping.pose_graph.teams import SETTINGS, Overlap, OverlapVotes, Teams, overlap_of
from rce.mapping.scans import Scan


class TeamMapper:
    """Mapper of a team of robots.

    Each robot maps on its own; places of one are searched in the maps of the others. When enough overlaps agree on the
    relative pose of two maps, the graphs are joined and optimised as one. Howard, Multi-robot Simultaneous Localization
    and Mapping using Particle Filters, 2006, treats unknown starts; overlaps are accepted by pairwise consistency as in
    Mangelson et al., Pairwise Consistent Measurement Set Maximization for Robust Multi-Robot Map Merging, 2018.

    The poses of a joined robot are in the frame of the first robot of its team, those of a single one in its own.
    """

    def __init__(self, names: Iterable[str], settings: MapperSettings | None = None) -> None:
        """Start a map for each robot."""
        self.settings = settings or MapperSettings()
        self.names = list(names)
        self._mappers = {name: GraphMapper(self.settings) for name in self.names}
        self._maps = {name: WholeMap(mapper.graph) for name, mapper in self._mappers.items()}
        self._complete = dict.fromkeys(self.names, 0)  # nodes that have been compared
        self._votes: dict[tuple[str, str], OverlapVotes] = {}
        self._teams = Teams({name: mapper.graph for name, mapper in self._mappers.items()}, self.settings.resolution)

    def add(self, name: str, scan: Scan) -> Estimate:
        """Map the next scan of a robot."""
        mapper = self._mappers[name]
        own = mapper.add(scan)
        self._teams[name].update(name)
        self._teams[name].compare_next()  # one with each scan bounds the time that a scan takes
        while self._complete[name] < len(mapper.graph.nodes) - 1:
            self._compare(name, self._complete[name])
            self._complete[name] += 1
        team, near = self._teams[name], mapper.reference
        return replace(own, pose=team.pose(name, near) @ mapper.graph.nodes[near].pose.to(own.pose))

    def settle(self) -> None:
        """Make all comparisons that wait, and optimise, before a result is read. This may take seconds."""
        for team in self._teams:
            team.settle()

    def team(self, name: str) -> list[str]:
        """Return the robots whose maps are joined with that of this robot, itself included."""
        return self._teams.members(name)

    def grid(self, name: str) -> OccupancyGrid:
        """Return the map of the team of a robot."""
        return self._teams[name].grid()

    def trajectory(self, name: str) -> NDArray[np.float64]:
        """Return (n, 4) stamp, x, y, theta of each scan of a robot, frame of its team."""
        mapper, team = self._mappers[name], self._teams[name]
        return mapper.trajectory_by(np.array([team.pose(name, number) for number in mapper.graph.nodes]))

    def _compare(self, name: str, number: int) -> None:
        """Search a complete place of a robot in its team, and in the maps of all robots of other teams."""
        self._teams[name].compare(name, number)
        query = None if number % SETTINGS.every else place_points(self._mappers[name].graph, number)
        if query is None:
            return
        for other in self.names:
            graph = self._mappers[other].graph
            if not self._teams.are_joined(name, other) and len(graph.nodes) > 1:
                found = self._maps[other].find(query)
                if found is not None:
                    self._add_overlap(name, other, overlap_of(number, graph, found))

    def _add_overlap(self, name: str, other: str, overlap: Overlap) -> None:
        """Join two teams once enough overlaps between them agree."""
        if (name, other) not in self._votes:
            self._votes[name, other] = OverlapVotes(self._mappers[name].graph, self._mappers[other].graph)
        agreeing = self._votes[name, other].add(overlap)
        if agreeing:
            self._teams.join(name, other, agreeing)
