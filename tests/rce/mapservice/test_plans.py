"""Plans on the maps of jobs, by HTTP."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import pytest

from rce.api.map_jobs import PlanPose, PlanRequest
from rce.client.map_service import MapServiceClient
from rce.errors import InternalError, LimitExceeded, RceError, TimedOut
from rce.mapping.files.outputs import write_map
from rce.mapservice.plans import PER_USER, Plans
from tests.support.map_service import Service
from tests.support.planning import walled

ENDS = {"start": {"x": 2, "y": 2}, "goal": {"x": 8, "y": 2}}
REQUEST = PlanRequest(PlanPose(2, 2), PlanPose(8, 2), max_planning_time=0.01)


async def finished(service: Service, with_map: bool = True) -> str:
    """Return a job that is done."""
    job = await service.submit()
    if with_map:
        write_map(Path(service.runner.task(job).out) / "map", walled())
    service.runner.finish(job)
    async with asyncio.timeout(20):
        async for state in service.service.jobs.watch("ann", job):
            if state.state == "done":
                break
    return job


@pytest.mark.slow
async def test_path_is_planned_on_the_map_of_a_job(service: Service) -> None:
    job = await finished(service)
    answer = await service.request("POST", f"/jobs/{job}/plan", json=ENDS)
    assert answer.status == 200, await answer.text()
    plan: dict[str, Any] = await answer.json()
    assert plan["poses"][0][:2] == [2, 2]
    assert plan["poses"][-1] == [8, 2, 0, 1]
    assert plan["length"] > 12
    client = MapServiceClient(service.url.removesuffix("/map-service"), key="rce_ann")
    found = await asyncio.to_thread(client.plan, job, PlanRequest(PlanPose(2, 2), PlanPose(8, 2)))
    assert found.length == plan["length"]
    with pytest.raises(RceError) as raised:
        await asyncio.to_thread(client.plan, job, PlanRequest(PlanPose(2, 2), PlanPose(99, 2)))
    assert raised.value.info.code == "no_path"
    assert raised.value.info.fields["reason"] == "goal_outside_map"


async def test_request_is_checked(service: Service) -> None:
    job = await finished(service)
    for body in ({}, {**ENDS, "planner": "magic"}, {**ENDS, "goal": {"x": 1}}, {**ENDS, "max_planning_time": 1e9}):
        assert (await service.request("POST", f"/jobs/{job}/plan", json=body)).status == 400
    assert (await service.request("POST", f"/jobs/{job}/plan", "bob", json=ENDS)).status == 404
    assert (await service.request("POST", "/jobs/none/plan", json=ENDS)).status == 404


async def test_job_without_a_map_is_refused(service: Service) -> None:
    job = await finished(service, with_map=False)
    answer = await service.request("POST", f"/jobs/{job}/plan", json=ENDS)
    assert answer.status == 400
    assert "has no map in the plane" in await answer.text()


async def test_processes_are_bounded_in_time_and_number(service: Service) -> None:
    job = await finished(service)
    asleep = Plans(service.service.jobs, (sys.executable, "-c", "import time; time.sleep(600)"), overhead=0.01)
    with pytest.raises(TimedOut):
        await asleep.plan("ann", job, REQUEST)
    patient = Plans(service.service.jobs, (sys.executable, "-c", "import time; time.sleep(600)"), overhead=600)
    running = [asyncio.create_task(patient.plan("ann", job, REQUEST)) for _ in range(PER_USER)]
    await asyncio.sleep(0)
    with pytest.raises(LimitExceeded):
        await patient.plan("ann", job, REQUEST)
    for task in running:
        task.cancel()
    await asyncio.gather(*running, return_exceptions=True)


async def test_process_that_ends_without_an_answer_is_an_error_of_the_service(service: Service) -> None:
    job = await finished(service)
    with pytest.raises(InternalError, match="status 3"):
        await Plans(service.service.jobs, (sys.executable, "-c", "raise SystemExit(3)")).plan("ann", job, REQUEST)
