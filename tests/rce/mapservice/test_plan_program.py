"""The program that plans one path."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from rce.api.map_jobs import PlanPose, PlanRequest
from rce.mapping.files.outputs import write_map
from rce.mapservice.plan_program import PlanAnswer, PlanTask, work
from rce.planning.failures import NoPath
from tests.support.planning import walled


@pytest.fixture
def map_file(tmp_path: Path) -> str:
    write_map(tmp_path / "map", walled())
    return str(tmp_path / "map.yaml")


def test_path_leads_from_start_to_goal(map_file: str) -> None:
    plan = work(PlanTask(map_file, PlanRequest(PlanPose(2, 2), PlanPose(8, 2, 1))))
    first, last = plan.poses[0], plan.poses[-1]
    assert (first.x, first.y) == (2, 2)
    assert (last.x, last.y, last.theta, last.direction) == (8, 2, 1, 1)


def test_goal_in_a_wall_has_no_path(map_file: str) -> None:
    with pytest.raises(NoPath):
        work(PlanTask(map_file, PlanRequest(PlanPose(2, 2), PlanPose(5.05, 2))))


@pytest.mark.slow
def test_answer_of_the_process_has_the_error(tmp_path: Path) -> None:
    task = PlanTask(str(tmp_path / "none.yaml"), PlanRequest(PlanPose(2, 2), PlanPose(8, 2)))
    program = [sys.executable, "-P", "-m", "rce.mapservice.plan_program"]
    done = subprocess.run(program, input=msgspec.json.encode(task), stdout=subprocess.PIPE, check=True)
    answer = msgspec.json.decode(done.stdout, type=PlanAnswer)
    assert answer.plan is None
    assert answer.error is not None
    assert answer.error.code == "not_found"
