"""Tests of both mappers with scans that cannot be used."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.geometry import Pose
from rce.mapping.mapper import Mapper
from rce.mapping.mappers import MAPPERS
from tests.support.paths import ROOT

STEP = Pose(0.1, 0.0, 0.05)


@pytest.fixture(params=MAPPERS)
def mapper(request: pytest.FixtureRequest) -> Mapper:
    return MAPPERS[request.param]()


@pytest.mark.parametrize("ranges", [[], [np.nan] * 360, [np.inf] * 360], ids=["empty", "nan", "inf"])
def test_unusable_scan_moves_by_odometry(mapper: Mapper, simulation: Simulation, ranges: list[float]) -> None:
    for scan in simulation.records[:20]:
        before = mapper.add(scan)
    assert scan.odometry
    blind = dataclasses.replace(
        scan, stamp=scan.stamp + 0.1, ranges=np.array(ranges, np.float32), odometry=scan.odometry @ STEP
    )
    estimate = mapper.add(blind)
    assert not estimate.matched
    assert estimate.pose == pytest.approx(before.pose @ STEP, abs=0.002)
    assert len(mapper.trajectory()) == 21


def test_late_and_duplicate_scans_are_answered_but_not_mapped(mapper: Mapper, simulation: Simulation) -> None:
    scans = simulation.records[:30]
    for scan in scans:
        mapper.add(scan)
    before = mapper.trajectory()
    mapper.add(scans[-1])
    late = mapper.add(scans[10])
    assert (late.accepted, late.matched, late.stamp) == (False, False, scans[10].stamp)
    assert late.pose == pytest.approx(tuple(before[10, 1:]))
    np.testing.assert_array_equal(mapper.trajectory(), before)


def test_map_is_empty_before_the_first_scan(mapper: Mapper) -> None:
    assert mapper.trajectory().shape == (0, 4)
    assert mapper.grid().cells.max() == -1


@pytest.mark.slow
def test_import_of_mappers_compiles_all_kernels() -> None:
    """The image of the mapping nodes fills the cache of Numba by this import."""
    sources = {path for path in (ROOT / "rce" / "mapping").rglob("*.py") if "\n@compiled(" in path.read_text()}
    program = "import sys, rce.mapping.mappers; print(*(getattr(m, '__file__', None) for m in sys.modules.values()))"
    loaded = subprocess.run([sys.executable, "-P", "-c", program], capture_output=True, check=True, text=True).stdout
    assert sources <= {Path(name) for name in loaded.split()}
    assert "import rce.mapping.mappers'" in (ROOT / "containers" / "images" / "mapping" / "Dockerfile").read_text()
