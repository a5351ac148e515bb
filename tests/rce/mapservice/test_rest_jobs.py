"""REST interface of the map service: jobs, their events and files."""

from __future__ import annotations

import asyncio
import json

import pytest

from rce.errors import InvalidRequest, NotFound, Unauthorized
from rce.mapservice.job_program import Report
from tests.support.map_service import Service


async def test_event_stream_ends_when_the_key_is_revoked(service: Service) -> None:
    job = await service.submit()
    answer = await service.session.get(f"{service.url}/jobs/{job}/events?key=rce_ann")
    assert await answer.content.readline() == b"event: job\n"
    service.service.authenticator.invalidate("bob")
    service.service.authenticator.invalidate("ann")  # the client is authenticated again, with success
    service.runner.report(job, Report(scans=1))
    async with asyncio.timeout(20):
        while await answer.content.readline() != b"event: job\n":
            pass
        service.master.failure = Unauthorized("revoked")
        service.service.authenticator.invalidate("ann")
        await answer.content.read()


async def test_event_stream_ends_when_the_job_is_removed(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    """That happens to a client that reads so slowly that the job ends and is removed meanwhile."""

    def gone(*_: object) -> None:
        raise NotFound("there is no such job")

    job = await service.submit()
    answer = await service.session.get(f"{service.url}/jobs/{job}/events?key=rce_ann")
    async with asyncio.timeout(20):
        assert await answer.content.readline() == b"event: job\n"
        monkeypatch.setattr(service.service._store, "find", gone)
        service.runner.report(job, Report(scans=1))
        lines = (await answer.content.read()).splitlines()
    assert {line.partition(b":")[0] for line in lines} <= {b"event", b"data", b""}


async def test_events_and_files_of_a_job(service: Service) -> None:
    job = await service.submit(resolution=0.1)
    answer = await service.session.get(f"{service.url}/jobs/{job}/events?key=rce_ann")
    assert answer.content_type == "text/event-stream"
    async with asyncio.timeout(20):
        service.runner.report(job, Report("mapping", 5, 12))
        service.runner.finish(job)
        states = [json.loads(line[6:]) async for line in answer.content if line.startswith(b"data: ")]
    assert states[-1]["state"] == "done"
    assert states[-1]["options"]["resolution"] == 0.1
    picture = await service.request("GET", f"/jobs/{job}/files/map.png")
    assert (picture.status, picture.content_type, await picture.read()) == (200, "image/png", b"a picture")
    assert (await service.request("GET", f"/jobs/{job}/files/..%2Frecord.json")).status == 404
    assert (await service.request("GET", f"/jobs/{job}/files/map.pgm")).status == 404
    assert [each["id"] for each in await (await service.request("GET", "/jobs")).json()] == [job]
    assert (await service.request("DELETE", f"/jobs/{job}")).status == 204
    assert (await service.request("GET", f"/jobs/{job}")).status == 404


async def test_job_can_be_cancelled(service: Service) -> None:
    job = await service.submit()
    assert (await service.request("DELETE", f"/jobs/{job}")).status == 400
    upload = (await (await service.request("GET", f"/jobs/{job}")).json())["uploads"][0]
    assert (await service.request("DELETE", f"/uploads/{upload}")).status == 400, "a job needs it"
    assert (await service.request("POST", f"/jobs/{job}/cancel")).status == 200
    async with asyncio.timeout(20):  # the event stream ends when the job is over
        await service.request("GET", f"/jobs/{job}/events")
    assert (await (await service.request("GET", f"/jobs/{job}")).json())["state"] == "cancelled"
    assert (await service.request("DELETE", f"/uploads/{upload}")).status == 204


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ("{", ""),
        ("[]", ""),
        ("{}", ""),
        ('{"uploads": []}', "uploads"),
        ('{"uploads": ["x"]}', "uploads[0]"),
        ('{"uploads": ["0"], "options": {"resolution": 9}}', "options.resolution"),
        ('{"uploads": ["0"], "options": {"resolution": "x"}}', "options.resolution"),
        ('{"uploads": ["0"], "options": {"mapper": "magic"}}', "options.mapper"),
        ('{"uploads": ["0"], "options": {"scan_topic": "scan; rm"}}', "options.scan_topic"),
        ('{"uploads": ["0"], "options": {"colour": "red"}}', "options"),
        ('{"uploads": ["0"]}', "uploads[0]"),
    ],
)
async def test_error_names_the_wrong_field(service: Service, body: str, field: str) -> None:
    answer = await service.request("POST", "/jobs", data=body)
    problem = await answer.json()
    assert answer.status in (400, 404)
    assert problem.get("field", "") == field
    assert problem["code"] in ("invalid_request", "not_found")


async def test_recording_without_scans_is_refused(service: Service) -> None:
    service.runner.inspect_error = InvalidRequest("a.log has no laser scans", field="uploads")
    answer = await service.request("POST", "/jobs", json={"uploads": [await service.upload()]})
    assert (answer.status, (await answer.json())["field"]) == (400, "uploads")
    assert await (await service.request("GET", "/jobs")).json() == []


async def test_number_of_waiting_jobs_is_limited(service: Service) -> None:
    for _ in range(4):
        await service.submit()
    answer = await service.request("POST", "/jobs", json={"uploads": [await service.upload()]})
    assert (answer.status, (await answer.json())["code"]) == (413, "limit_exceeded")


async def test_number_of_simultaneous_inspections_is_limited(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each inspection is a process, and a client may send many requests at once."""
    released, inspecting = asyncio.Event(), 0

    async def inspect(task: object) -> None:
        nonlocal inspecting
        inspecting += 1
        await released.wait()

    monkeypatch.setattr(service.runner, "inspect", inspect)
    upload = await service.upload()
    requests = [asyncio.ensure_future(service.request("POST", "/jobs", json={"uploads": [upload]})) for _ in range(3)]
    done, waiting = await asyncio.wait(requests, timeout=20, return_when=asyncio.FIRST_COMPLETED)
    assert [(each.result().status, len(waiting), inspecting) for each in done] == [(413, 2, 2)]
    released.set()
    assert [(await each).status for each in waiting] == [201, 201]


async def test_jobs_survive_a_restart(service: Service) -> None:
    job = await service.submit()
    await service.service.stop()
    await service.session.close()
    service.runner = type(service.runner)()
    await service.start()
    found = await (await service.request("GET", f"/jobs/{job}")).json()
    assert found["state"] == "running"
    assert service.runner.task(job).former == [f"map_{job}_1"]
