"""Tests of the worker of a parallel mapping job."""

from __future__ import annotations

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.scan_arrays import ScanArrays, pack_scans
from rce.mapping.parallel.states import PartMap, SeedMap, unpack_overlaps
from rce.mapping.parallel.units import (
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
from rce.mapping.parallel.worker import Worker
from rce.mapping.pose_graph.mapper import GraphMapper

SETTINGS = MapperSettings(particles=2)


def done(worker: Worker, work: Work) -> bytes:
    result = worker.execute(Unit(1, work)).result
    assert isinstance(result, Mapped), result
    return result.state


@pytest.fixture
def scans(simulation: Simulation) -> ScanArrays:
    return pack_scans(simulation.records[:40])


def test_part_is_mapped_as_by_the_mapper(simulation: Simulation, scans: ScanArrays) -> None:
    mapper, reported = GraphMapper(SETTINGS), []
    for scan in simulation.records[:40]:
        mapper.add(scan)
    answer = Worker().execute(Unit(7, MapPart(0, scans, SETTINGS)), reported.append)
    assert isinstance(answer.result, Mapped)
    part = PartMap.unpack(answer.result.state)
    assert np.array_equal(part.history.trajectory(part.graph.poses()), mapper.trajectory())
    assert (answer.number, reported[-1]) == (7, 40)
    assert answer.result.seconds > 0


def test_seeds_give_maps(scans: ScanArrays) -> None:
    found = SeedMap.unpack(done(Worker(), MapSeed(scans, SETTINGS)))
    assert len(found.trajectory) == 40
    assert found.occupied > 100


def test_parts_of_other_workers_are_kept(scans: ScanArrays) -> None:
    part = done(Worker(), MapPart(0, scans, SETTINGS))
    worker = Worker()
    assert done(worker, KeepPart(0, part)) == done(worker, KeepPart(1, part)) == b""
    graph = PartMap.unpack(part).graph
    assert len(unpack_overlaps(done(worker, FindOverlaps(0, 1)), graph, graph)) in (0, 3), "none, or enough that agree"


@pytest.mark.parametrize(
    ("work", "reason"),
    [
        (FindOverlaps(0, 5), "does not have part 0"),
        (KeepPart(0, b"nothing"), "not a state of a map"),
        (ComparePlaces([1], b"", [0]), "does not have part 1"),
    ],
)
def test_impossible_work_fails(work: Work, reason: str) -> None:
    answer = Worker().execute(Unit(3, work))
    assert isinstance(answer.result, Failed)
    assert reason in answer.result.error.message
    assert answer.number == 3
