"""Worker of a parallel mapping job: executes units of work, without ROS."""

from __future__ import annotations

import time
from collections.abc import Callable

from rce.errors import InvalidRequest, RceError
from rce.mapping.parallel.scan_arrays import ScanArrays, unpack_scans
from rce.mapping.parallel.states import PartMap, SeedMap, pack_comparisons, pack_overlaps, unpack_state
from rce.mapping.parallel.units import (
    Answer,
    ComparePlaces,
    Failed,
    FindOverlaps,
    KeepPart,
    MapPart,
    Mapped,
    MapSeed,
    Unit,
    Work,
)
from rce.mapping.particles.mapper import ParticleMapper
from rce.mapping.pose_graph.graph import PoseGraph
from rce.mapping.pose_graph.mapper import GraphMapper
from rce.mapping.pose_graph.team_graph import Team
from rce.mapping.pose_graph.teams import find_overlaps

Report = Callable[[int], None]


class Worker:
    """Executes units one after the other, and keeps the parts that it has mapped or was given."""

    def __init__(self) -> None:
        """Start without any part."""
        self._graphs: dict[int, PoseGraph] = {}
        self._team: tuple[bytes, Team] | None = None  # the last snapshot, as many units have the same one

    def execute(self, unit: Unit, report: Report = lambda scans: None) -> Answer:
        """Execute a unit.

        Args:
            unit: The unit.
            report: Called with the number of scans mapped so far.
        """
        began = time.monotonic()
        try:
            state = self._execute(unit.work, report)
        except RceError as error:
            return Answer(unit.number, Failed(error.info))
        return Answer(unit.number, Mapped(state, time.monotonic() - began))

    def _execute(self, work: Work, report: Report) -> bytes:
        match work:
            case MapPart(part, scans, settings):
                mapper = GraphMapper(settings)
                _add_all(mapper, scans, report)
                self._graphs[part] = mapper.graph
                return PartMap(mapper.graph, mapper.history).pack()
            case MapSeed(scans, settings):
                particles = ParticleMapper(settings)
                _add_all(particles, scans, report)
                return SeedMap(particles.grid(), particles.trajectory()).pack()
            case FindOverlaps(own, other):
                return pack_overlaps(find_overlaps(self._graph(own), self._graph(other)))
            case ComparePlaces(parts, snapshot, nodes):
                team = self._restore_team(parts, snapshot)
                if any(not 0 <= node < len(team.graph.nodes) for node in nodes):
                    raise InvalidRequest("a unit compares nodes that its team does not have", field="nodes")
                return pack_comparisons([team.comparison(node) for node in nodes], team.names)
            case KeepPart(part, state):
                self._graphs[part] = PartMap.unpack(state).graph
                return b""

    def _restore_team(self, parts: list[int], snapshot: bytes) -> Team:
        if self._team is None or self._team[0] != snapshot:
            graphs = {str(part): self._graph(part) for part in parts}
            self._team = snapshot, Team.of_snapshot(graphs, unpack_state(snapshot), resolution=1.0)  # without a map
        return self._team[1]

    def _graph(self, part: int) -> PoseGraph:
        if part not in self._graphs:
            raise InvalidRequest(f"the worker does not have part {part}", field="part")
        return self._graphs[part]


def _add_all(mapper: GraphMapper | ParticleMapper, scans: ScanArrays, report: Report) -> None:
    for count, scan in enumerate(unpack_scans(scans), 1):
        mapper.add(scan)
        report(count)
