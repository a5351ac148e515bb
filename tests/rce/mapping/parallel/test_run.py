"""Runs of parallel mapping jobs, with workers in this process."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from rce.client import Robot
from rce.errors import InvalidRequest
from rce.mapping.evaluation.simulation import Simulation
from rce.mapping.mapper import MapperSettings
from rce.mapping.parallel.environments import EnvironmentWorker
from rce.mapping.parallel.run import Method, environments, run
from tests.support.mapping_crew import LocalWorker

ROBOT = cast(Robot, None)


@pytest.fixture
def hired(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the environments of the workers."""
    names: list[str] = []

    async def hire(cls: Any, robot: Robot, tag: str) -> LocalWorker:
        names.append(tag)
        return LocalWorker()

    monkeypatch.setattr(EnvironmentWorker, "hire", classmethod(hire))
    return names


@pytest.mark.parametrize("mapper", ["graph", "particle"])
async def test_each_worker_has_an_environment(hired: list[str], simulation: Simulation, mapper: Any) -> None:
    reported: list[int] = []
    recordings = [simulation.records[:40], iter(simulation.records[40:70])]
    method = Method(2, mapper, MapperSettings(particles=2))
    done = await run(ROBOT, "job", recordings, method, reported.append)
    assert sorted(hired) == environments("job", 2) == ["job_0", "job_1"]
    assert sorted(len(each) for joint in done.maps for each in joint.trajectories.values()) == [30, 40]
    assert max(reported) == 70
    assert done.lost == 0
    assert {unit.kind for unit in done.units} <= {"map_part", "find_overlaps", "compare_places", "map_seed"}
    assert all((joint.grid.cells > 50).any() for joint in done.maps)
    assert np.isfinite(np.concatenate(list(done.maps[0].trajectories.values()))).all()


async def test_recording_without_scans_is_refused_before_workers_are_hired(
    hired: list[str], simulation: Simulation
) -> None:
    with pytest.raises(InvalidRequest, match="recording 2 has no laser scans"):
        await run(ROBOT, "job", [simulation.records[:5], []], Method(1, "graph", MapperSettings()))
    assert not hired
