"""Parallel mapping of recordings: units of work for a crew, and the joint maps made of the results."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rce.errors import InvalidRequest
from rce.mapping.grid import OccupancyGrid
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.crew import Crew
from rce.mapping.parallel.scan_arrays import pack_scans
from rce.mapping.parallel.states import PartMap, SeedMap, pack_state, unpack_comparisons, unpack_overlaps
from rce.mapping.parallel.units import MAX_SCANS, ComparePlaces, FindOverlaps, MapPart, MapSeed
from rce.mapping.pose_graph.graph import Edge
from rce.mapping.pose_graph.team_graph import Comparison, Team
from rce.mapping.pose_graph.teams import Teams
from rce.mapping.scans import Scan

Trajectory = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ParallelSettings:
    """Settings of cutting a job into units.

    Attributes:
        min_scans: Scans of a piece of a recording at least; shorter ones would have hardly any map to match with.
        shared: Scans that a piece has in common with the one before it.
        seam: Standard deviations, metres and radians, of the motion between two pieces by their shared scans.
        every: Nodes from one that is compared to the next; places overlap, and a comparison costs much.
        nodes: Nodes of one unit of comparisons.
    """

    min_scans: int = 250
    shared: int = 20
    seam: tuple[float, float] = (0.05, math.radians(1))
    every: int = 3
    nodes: int = 16


SETTINGS = ParallelSettings()


@dataclass(frozen=True, slots=True)
class JointMap:
    """Map of recordings that overlap.

    Attributes:
        grid: The map.
        trajectories: (n, 4) stamp, x, y, theta of each scan of each recording, map frame, by number of the recording.
    """

    grid: OccupancyGrid
    trajectories: dict[int, Trajectory]


@dataclass(frozen=True, slots=True)
class Piece:
    """Piece of a recording, which becomes a part.

    Attributes:
        recording: Number of the recording.
        scans: Scans of the piece.
        until: Stamp from which on the next piece has the trajectory; infinite for the last piece.
    """

    recording: int
    scans: Sequence[Scan]
    until: float


async def map_together(
    crew: Crew, recordings: Sequence[Sequence[Scan]], settings: MapperSettings, workers: int
) -> list[JointMap]:
    """Map recordings with the mapper `graph`, and join those that overlap.

    Each recording, or each piece if there are fewer recordings than workers, is mapped on its own. Pieces of a
    recording are joined by the scans that they share, recordings by overlaps, as `TeamMapper` does. Then places are
    compared with all places near by until nothing moves any more.

    Args:
        crew: The crew.
        recordings: Scans of each, in order of time.
        settings: Settings of the mapper.
        workers: Number of workers for which the recordings are cut. The result depends on it, but not on which worker
            executes what.

    Returns:
        The maps; that of the first recording comes first.

    Raises:
        InvalidRequest: A recording has no scans.
        RceError: The crew has failed.
    """
    cut = [
        piece for number, scans in enumerate(recordings) for piece in pieces(number, scans, _count(recordings, workers))
    ]
    parts = await _map_parts(crew, cut, settings)
    teams = Teams({str(number): part.graph for number, part in enumerate(parts)}, settings.resolution)
    for number, (piece, following) in enumerate(pairwise(cut)):
        if following.recording == piece.recording:
            teams.chain(str(number), str(number + 1), seam(parts[number], parts[number + 1], piece.until))
    await _settle(crew, teams)
    if len(recordings) > 1:
        await _join(crew, cut, parts, teams)
        await _settle(crew, teams)
    return await asyncio.to_thread(lambda: list(_joint_maps(cut, parts, teams)))


async def map_seeds(
    crew: Crew, recordings: Sequence[Sequence[Scan]], settings: MapperSettings, seeds: int
) -> list[JointMap]:
    """Map each recording with the mapper `particle` and several seeds, and keep the best map of each.

    Raises:
        InvalidRequest: A recording has no scans.
        RceError: The crew has failed.
    """
    packed = [pack_scans(_checked(scans)) for scans in recordings]
    units = [
        MapSeed(
            scans, MapperSettings(settings.resolution, settings.max_range, settings.particles, settings.seed + seed)
        )
        for scans in packed
        for seed in range(seeds)
    ]
    results = await asyncio.gather(*(crew.run(unit) for unit in units))
    maps = [SeedMap.unpack(state) for state in results if state is not None]
    best = [min(maps[first : first + seeds], key=lambda each: each.occupied) for first in range(0, len(maps), seeds)]
    return [JointMap(each.grid, {number: each.trajectory}) for number, each in enumerate(best)]


def pieces(recording: int, scans: Sequence[Scan], count: int) -> Iterator[Piece]:
    """Yield a recording in up to `count` pieces of the same length; more only if they would be too large for a unit.

    Raises:
        InvalidRequest: The recording has no scans.
    """
    whole = len(_checked(scans))
    count = max(math.ceil(whole / (MAX_SCANS - SETTINGS.shared)), min(count, whole // SETTINGS.min_scans), 1)
    for number in range(count):
        first, end = (whole * number) // count, (whole * (number + 1)) // count
        last = number == count - 1
        until = math.inf if last else scans[end + SETTINGS.shared // 2].stamp
        yield Piece(recording, scans[first : None if last else end + SETTINGS.shared], until)


def seam(before: PartMap, after: PartMap, stamp: float) -> Edge:
    """Return the motion between the nodes of two parts near which a scan was taken that both have."""
    (first, one), (second, other) = before.history.at(stamp), after.history.at(stamp)
    metres, radians = SETTINGS.seam
    return Edge(first, second, one @ other.inverse(), np.diag(1 / np.square([metres, metres, radians])))


def _checked(scans: Sequence[Scan]) -> Sequence[Scan]:
    if not scans:
        raise InvalidRequest("a recording has no laser scans", field="path")
    return scans


def _count(recordings: Sequence[object], workers: int) -> int:
    """Return the number of pieces of each recording, so that no worker is idle at first."""
    return math.ceil(workers / max(len(recordings), 1))


async def _map_parts(crew: Crew, cut: Sequence[Piece], settings: MapperSettings) -> list[PartMap]:
    units = [MapPart(number, pack_scans(piece.scans), settings) for number, piece in enumerate(cut)]
    results = await asyncio.gather(*(crew.run(unit) for unit in units))
    return await asyncio.to_thread(lambda: [PartMap.unpack(state) for state in results if state is not None])


async def _join(crew: Crew, cut: Sequence[Piece], parts: Sequence[PartMap], teams: Teams) -> None:
    """Join teams that overlap.

    Results are taken in the order of the units, so that the maps do not depend on which worker is faster.
    """
    pairs = [
        (first, second) if len(parts[first].graph.nodes) <= len(parts[second].graph.nodes) else (second, first)
        for second in range(len(parts))
        for first in range(second)
        if cut[first].recording != cut[second].recording
    ]

    def are_apart(own: int, other: int) -> bool:
        return not teams.are_joined(str(own), str(other))

    searches = [
        asyncio.create_task(crew.run(FindOverlaps(*pair), lambda pair=pair: are_apart(*pair)))  # type: ignore[misc]
        for pair in pairs
    ]
    try:
        for (own, other), search in zip(pairs, searches, strict=True):
            state = await search
            if state is None or not are_apart(own, other):
                continue
            overlaps = unpack_overlaps(state, parts[own].graph, parts[other].graph)
            if overlaps:
                await asyncio.to_thread(teams.join, str(own), str(other), overlaps)
    finally:
        for search in searches:
            search.cancel()
        await asyncio.gather(*searches, return_exceptions=True)


async def _settle(crew: Crew, teams: Teams) -> None:
    """Compare all places that wait, and optimise, until no place moves any more."""
    await asyncio.gather(*(_settle_team(crew, team) for team in teams))


async def _settle_team(crew: Crew, team: Team) -> None:
    while nodes := team.take_waiting()[:: SETTINGS.every]:
        parts, snapshot = [int(name) for name in team.names], pack_state(team.snapshot())
        batches = [nodes[first : first + SETTINGS.nodes] for first in range(0, len(nodes), SETTINGS.nodes)]
        results = await asyncio.gather(*(crew.run(ComparePlaces(parts, snapshot, batch)) for batch in batches))
        found: list[Comparison] = []
        for batch, state in zip(batches, results, strict=True):
            found += unpack_comparisons(state or b"", batch, team.names, len(team.graph.nodes))
        await asyncio.to_thread(team.add_comparisons, found)


def _joint_maps(cut: Sequence[Piece], parts: Sequence[PartMap], teams: Teams) -> Iterator[JointMap]:
    for team in teams:
        trajectories: dict[int, list[Trajectory]] = {}
        for number in sorted(map(int, team.names)):
            graph, piece = parts[number].graph, cut[number]
            rows = parts[number].history.trajectory(np.array([team.pose(str(number), node) for node in graph.nodes]))
            before = cut[number - 1] if number else None
            since = before.until if before is not None and before.recording == piece.recording else -math.inf
            rows = rows[(rows[:, 0] >= since) & (rows[:, 0] < piece.until)]
            trajectories.setdefault(piece.recording, []).append(rows)
        yield JointMap(team.grid(), {number: np.concatenate(rows) for number, rows in trajectories.items()})
