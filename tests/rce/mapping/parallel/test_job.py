"""Tests of parallel mapping jobs, with workers in this process."""

from __future__ import annotations

import asyncio
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.evaluation.trials import error_of, read_relations
from rce.mapping.files.recordings import open_recording
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.crew import Crew
from rce.mapping.parallel.job import SETTINGS, JointMap, map_seeds, map_together, pieces
from rce.mapping.parallel.units import MAX_SCANS
from rce.mapping.scans import Scan
from tests.support.mapping_crew import LocalCrew, dies

SCAN = Scan(0.0, np.zeros(0, np.float32), 0.0, 0.1, 1.0)


def numbered(count: int) -> list[Scan]:
    return [Scan(float(stamp), SCAN.ranges, 0.0, 0.1, 1.0) for stamp in range(count)]


async def together(
    recordings: list[list[Scan]], pieces_for: int, local: LocalCrew | None = None, workers: int = 1
) -> list[JointMap]:
    async def at_once(seconds: float) -> None:
        await asyncio.sleep(0)

    async with Crew((local or LocalCrew()).hire, workers, pause=at_once) as crew:
        return await map_together(crew, recordings, MapperSettings(), pieces_for)


@pytest.mark.parametrize(
    ("scans", "wanted", "expected"),
    [(1000, 2, 2), (1000, 16, 4), (100, 8, 1), (3 * MAX_SCANS, 1, 4)],
)
def test_recording_is_cut_into_pieces_that_share_scans(scans: int, wanted: int, expected: int) -> None:
    cut = list(pieces(0, numbered(scans), wanted))
    assert len(cut) == expected
    assert all(len(piece.scans) <= MAX_SCANS for piece in cut)
    assert cut[-1].until == math.inf
    for before, after in pairwise(cut):
        shared = [scan.stamp for scan in before.scans if scan.stamp >= after.scans[0].stamp]
        assert len(shared) == SETTINGS.shared
        assert before.until in shared
    stamps = {scan.stamp for piece in cut for scan in piece.scans}
    assert len(stamps) == scans


def test_recording_without_scans_is_refused() -> None:
    with pytest.raises(InvalidRequest, match="no laser scans"):
        list(pieces(0, [], 1))


@pytest.mark.slow
async def test_pieces_become_one_map(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    """The trajectory has each scan once, and the map does not depend on how many workers there are."""
    scans = simulation.records
    one, two = [await together([scans], 2, workers=workers) for workers in (1, 2)]
    assert len(one) == len(two) == 1
    assert [row[0] for row in one[0].trajectories[0]] == [scan.stamp for scan in scans]
    assert np.array_equal(one[0].trajectories[0], two[0].trajectories[0])
    assert np.array_equal(one[0].grid.cells, two[0].grid.cells)


async def test_recordings_without_overlap_have_maps_of_their_own(simulation: Simulation) -> None:
    first, second = await together([simulation.records[:30], simulation.records[-30:]], 1)
    assert (list(first.trajectories), list(second.trajectories)) == ([0], [1])


async def test_best_seed_is_kept(simulation: Simulation) -> None:
    settings = MapperSettings(particles=2)
    async with Crew(LocalCrew().hire, 1) as crew:
        (best,) = await map_seeds(crew, [simulation.records[:60]], settings, 3)
        maps = [
            (await map_seeds(crew, [simulation.records[:60]], MapperSettings(particles=2, seed=seed), 1))[0]
            for seed in range(3)
        ]
    counts = [(each.grid.cells > 50).sum() for each in maps]
    assert np.array_equal(best.grid.cells, maps[int(np.argmin(counts))].grid.cells)


@pytest.mark.slow
async def test_recordings_of_one_building_become_one_map(data: Path) -> None:
    """Four recordings with unknown starts, whose workers die at first, are as accurate as one recording."""
    scans = list(open_recording(data / "mit-csail.clf.gz"))[::2]
    parts = [scans[0:350], scans[200:550], scans[400:800], scans[650:994]]
    local = LocalCrew({0: dies, 2: dies})
    (joint,) = await together(parts, 2, local, workers=2)
    assert sorted(joint.trajectories) == [0, 1, 2, 3]
    rows = np.concatenate([joint.trajectories[number] for number in range(4)])
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    assert error_of(rows, read_relations(data / "mit-csail.relations", rows[:, 0])).translation < 0.04
