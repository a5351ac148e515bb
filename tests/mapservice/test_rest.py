"""The REST interface as a client sees it."""

from __future__ import annotations

import asyncio
import base64
import errno
import json
from typing import Any
from urllib.parse import urlsplit

import pytest
from maps_in_memory import LOG, Service
from openapi_spec_validator import OpenAPIV31SpecValidator

from rce.calls.services import NoteDone
from rce.errors import InvalidRequest, Unauthorized, Unavailable
from rce.mapservice import uploads
from rce.mapservice.files import Shelf
from rce.mapservice.work import Report
from rce.metrics import families

PIECE = {"Content-Type": "application/offset+octet-stream"}
TUS = {"Tus-Resumable": "1.0.0"}


def metadata(name: str) -> dict[str, str]:
    return {"Upload-Metadata": f"filename {base64.b64encode(name.encode()).decode()}"}


async def test_tus_step_by_step(service: Service) -> None:
    answer = await service.ask("OPTIONS", "/uploads")
    assert (answer.status, answer.headers["Tus-Version"], answer.headers["Tus-Max-Size"]) == (204, "1.0.0", "10000000")
    length = {"Upload-Length": str(len(LOG))}
    answer = await service.ask("POST", "/uploads", headers={**TUS, **length, **metadata("a.log")})
    assert (answer.status, answer.headers["Upload-Offset"]) == (201, "0")
    place = answer.headers["Location"]
    answer = await service.ask("PATCH", place, headers={**TUS, **PIECE, "Upload-Offset": "0"}, data=LOG[:100])
    assert (answer.status, answer.headers["Upload-Offset"]) == (204, "100")
    answer = await service.ask("PATCH", place, headers={**TUS, **PIECE, "Upload-Offset": "0"}, data=LOG)
    assert answer.status == 409
    answer = await service.ask("HEAD", place, headers=TUS)
    assert (answer.status, answer.headers["Upload-Offset"]) == (200, "100")
    assert answer.headers["Upload-Length"] == str(len(LOG))
    assert answer.headers["Cache-Control"] == "no-store"
    answer = await service.ask("PATCH", place, headers={**TUS, **PIECE, "Upload-Offset": "100"}, data=LOG[100:])
    assert (answer.status, answer.headers["Upload-Offset"]) == (204, str(len(LOG)))
    assert [upload["name"] for upload in await (await service.ask("GET", "/uploads")).json()] == ["a.log"]
    assert (await service.ask("DELETE", place, headers=TUS)).status == 204
    assert (await service.ask("HEAD", place)).status == 404


async def test_whether_it_is_well_needs_no_credentials(service: Service) -> None:
    root = service.url.removesuffix("/map-service")
    for path in ("/healthz", "/readyz"):
        async with service.session.get(root + path) as answer:
            assert (answer.status, await answer.json()) == (200, {"status": "ok", "missing": []})
    service.master.away = Unavailable("it is away")
    async with service.session.get(root + "/readyz") as answer:
        assert answer.status == 503
        assert "Master" in (await answer.json())["missing"][0]


async def test_a_broken_connection_costs_nothing_that_had_come(service: Service) -> None:
    headers = {**TUS, "Upload-Length": str(len(LOG)), **metadata("a.log")}
    place = (await service.ask("POST", "/uploads", headers=headers)).headers["Location"]
    host, port = place.split("/")[2].split(":")
    _, writer = await asyncio.open_connection(host, int(port))
    lines = [f"PATCH {place} HTTP/1.1", "Host: x", "Authorization: Bearer rce_ann", "Upload-Offset: 0"]
    lines += [f"Content-Type: {PIECE['Content-Type']}", f"Content-Length: {len(LOG)}"]
    writer.write("\r\n".join([*lines, "", ""]).encode() + LOG[:300])
    await writer.drain()
    name = place.rpartition("/")[2]
    uploads = service.service.uploads
    async with asyncio.timeout(20):
        while name not in uploads._writers:  # noqa: ASYNC110
            await asyncio.sleep(0.005)
        writer.transport.abort()
        while name in uploads._writers:  # noqa: ASYNC110
            await asyncio.sleep(0.005)
    offset = int((await service.ask("HEAD", place)).headers["Upload-Offset"])
    assert 0 <= offset <= 300
    answer = await service.ask("PATCH", place, headers={**PIECE, "Upload-Offset": str(offset)}, data=LOG[offset:])
    assert answer.status == 204
    assert uploads.path(name).read_bytes() == LOG


@pytest.mark.parametrize(
    ("user", "upload", "status"),
    [("ann", "", "100"), ("nobody", "", "401"), ("ann", "0" * 24, "404"), ("bob", "", "404")],
)
async def test_a_client_that_asks_first_hears_what_is_wrong(
    service: Service, user: str, upload: str, status: str
) -> None:
    name = upload or service.service.uploads.create("ann", "a.log", len(LOG)).id
    host, port = service.url.split("/")[2].split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    lines = [f"PATCH /map-service/uploads/{name} HTTP/1.1", "Host: x", f"Authorization: Bearer rce_{user}"]
    lines += ["Expect: 100-continue", "Upload-Offset: 0", f"Content-Type: {PIECE['Content-Type']}"]
    writer.write("\r\n".join([*lines, f"Content-Length: {len(LOG)}", "", ""]).encode())
    async with asyncio.timeout(20):
        assert (await reader.readline()).split()[1] == status.encode()
        if status == "100":
            await reader.readline()
            writer.write(LOG)
            assert (await reader.readline()).split()[1] == b"204"
    writer.close()


@pytest.mark.parametrize(
    ("headers", "status", "field"),
    [
        ({"Upload-Length": "9", **metadata("a.csv")}, 400, "Upload-Metadata.filename"),
        ({"Upload-Length": "9"}, 400, "Upload-Metadata.filename"),
        ({"Upload-Length": "9", "Upload-Metadata": "filename é"}, 400, "Upload-Metadata"),
        (metadata("a.log"), 400, "Upload-Length"),
        ({"Upload-Length": "-1", **metadata("a.log")}, 400, "Upload-Length"),
        ({"Upload-Length": "0", **metadata("a.log")}, 400, "Upload-Length"),
        ({"Upload-Length": "99999999999", **metadata("a.log")}, 413, "Upload-Length"),
        ({"Upload-Length": "9", "Tus-Resumable": "0.2.2", **metadata("a.log")}, 412, "Tus-Resumable"),
    ],
)
async def test_uploads_that_are_refused(service: Service, headers: dict[str, str], status: int, field: str) -> None:
    answer = await service.ask("POST", "/uploads", headers=headers)
    assert (answer.status, answer.content_type) == (status, "application/problem+json")
    problem = await answer.json()
    assert (problem["status"], problem["field"]) == (status, field)
    assert problem["detail"]


async def test_a_recording_that_is_none_is_refused_by_its_first_bytes(service: Service) -> None:
    answer = await service.ask("POST", "/uploads?filename=a.bag", headers=PIECE, data=b"#ROSBAG V1.2\n" + bytes(9000))
    assert answer.status == 400
    assert "1.2" in (await answer.json())["detail"]
    assert await (await service.ask("GET", "/uploads")).json() == []


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


async def test_a_full_disk_is_said_and_what_came_is_kept(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    headers = {"Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"}
    announced = await service.ask("POST", "/uploads", headers={"Upload-Length": str(len(LOG))} | metadata("a.log"))
    place = announced.headers["Location"]
    monkeypatch.setattr(uploads, "_write_all", full)
    refused = await service.ask("PATCH", place, data=LOG, headers=headers)
    assert refused.status == 503
    assert (await refused.json())["code"] == "unavailable"
    assert "disk" in (await refused.json())["detail"]
    monkeypatch.undo()
    assert (await service.ask("PATCH", place, data=LOG, headers=headers)).status == 204


async def test_what_cannot_be_stored_is_no_job_and_no_upload(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    upload = await service.upload()
    monkeypatch.setattr(Shelf, "put", full)
    announced = await service.ask("POST", "/uploads", headers={"Upload-Length": "9"} | metadata("b.log"))
    submitted = await service.ask("POST", "/jobs", json={"uploads": [upload]})
    assert [announced.status, submitted.status] == [503, 503]
    assert [each["id"] for each in await (await service.ask("GET", "/uploads")).json()] == [upload]
    assert await (await service.ask("GET", "/jobs")).json() == []
    assert service.master.grants == {}, "the right to act for the user"
    assert not list((service.directory / "jobs").iterdir())


async def test_events_end_when_the_key_is_void(service: Service) -> None:
    job = await service.submit()
    answer = await service.session.get(f"{service.url}/jobs/{job}/events?key=rce_ann")
    assert await answer.content.readline() == b"event: job\n"
    service.service.access.forget("bob")
    service.service.access.forget("ann")  # asked anew: the key is good still
    service.workers.tell(job, Report(scans=1))
    async with asyncio.timeout(20):
        while await answer.content.readline() != b"event: job\n":
            pass
        service.master.away = Unauthorized("revoked")
        service.service.access.forget("ann")
        await answer.content.read()


async def test_a_job_with_its_events_and_files(service: Service) -> None:
    job = await service.submit(resolution=0.1)
    answer = await service.session.get(f"{service.url}/jobs/{job}/events?key=rce_ann")
    assert answer.content_type == "text/event-stream"
    async with asyncio.timeout(20):
        service.workers.tell(job, Report("mapping", 5, 12))
        service.workers.finish(job)
        states = [json.loads(line[6:]) async for line in answer.content if line.startswith(b"data: ")]
    assert states[-1]["state"] == "done"
    assert states[-1]["options"]["resolution"] == 0.1
    picture = await service.ask("GET", f"/jobs/{job}/files/map.png")
    assert (picture.status, picture.content_type, await picture.read()) == (200, "image/png", b"a picture")
    assert (await service.ask("GET", f"/jobs/{job}/files/..%2Frecord.json")).status == 404
    assert (await service.ask("GET", f"/jobs/{job}/files/map.pgm")).status == 404
    assert [each["id"] for each in await (await service.ask("GET", "/jobs")).json()] == [job]
    assert (await service.ask("DELETE", f"/jobs/{job}")).status == 204
    assert (await service.ask("GET", f"/jobs/{job}")).status == 404


async def test_cancelling_a_job(service: Service) -> None:
    job = await service.submit()
    assert (await service.ask("DELETE", f"/jobs/{job}")).status == 400
    upload = (await (await service.ask("GET", f"/jobs/{job}")).json())["uploads"][0]
    assert (await service.ask("DELETE", f"/uploads/{upload}")).status == 400, "the job needs it"
    assert (await service.ask("POST", f"/jobs/{job}/cancel")).status == 200
    async with asyncio.timeout(20):  # the events end when it is over
        await service.ask("GET", f"/jobs/{job}/events")
    assert (await (await service.ask("GET", f"/jobs/{job}")).json())["state"] == "cancelled"
    assert (await service.ask("DELETE", f"/uploads/{upload}")).status == 204


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
async def test_requests_that_are_wrong_name_the_field(service: Service, body: str, field: str) -> None:
    answer = await service.ask("POST", "/jobs", data=body)
    problem = await answer.json()
    assert answer.status in (400, 404)
    assert problem.get("field", "") == field
    assert problem["code"] in ("invalid_request", "not_found")


async def test_a_recording_without_scans_is_no_job(service: Service) -> None:
    service.workers.refuse = InvalidRequest("a.log has no laser scans", field="uploads")
    answer = await service.ask("POST", "/jobs", json={"uploads": [await service.upload()]})
    assert (answer.status, (await answer.json())["field"]) == (400, "uploads")
    assert await (await service.ask("GET", "/jobs")).json() == []


async def test_who_has_many_jobs_waits(service: Service) -> None:
    for _ in range(4):
        await service.submit()
    answer = await service.ask("POST", "/jobs", json={"uploads": [await service.upload()]})
    assert (answer.status, (await answer.json())["code"]) == (429, "limit_exceeded")


async def test_recordings_are_looked_at_a_few_at_once(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look is a process, and a client may ask for a thousand at once."""
    held, looking = asyncio.Event(), 0

    async def look(task: object) -> None:
        nonlocal looking
        looking += 1
        await held.wait()

    monkeypatch.setattr(service.workers, "look", look)
    upload = await service.upload()
    asked = [asyncio.ensure_future(service.ask("POST", "/jobs", json={"uploads": [upload]})) for _ in range(3)]
    done, waiting = await asyncio.wait(asked, timeout=20, return_when=asyncio.FIRST_COMPLETED)
    assert [(each.result().status, len(waiting), looking) for each in done] == [(429, 2, 2)]
    held.set()
    assert [(await each).status for each in waiting] == [201, 201]


async def test_others_see_nothing(service: Service) -> None:
    job, upload = await service.submit(), await service.upload()
    for method, path in (
        *(("GET", f"/jobs/{job}"), ("GET", f"/jobs/{job}/events"), ("POST", f"/jobs/{job}/cancel")),
        *(("DELETE", f"/jobs/{job}"), ("GET", f"/uploads/{upload}"), ("DELETE", f"/uploads/{upload}")),
        ("GET", f"/jobs/{job}/files/log.txt"),
    ):
        assert (await service.ask(method, path, "bob")).status == 404, path
    answer = await service.ask("POST", "/jobs", "bob", json={"uploads": [upload]})
    assert answer.status == 404


BASIC = base64.b64encode(b"ann:rce_ann").decode()


@pytest.mark.parametrize(
    ("query", "header", "status"),
    [
        ("", "", 401),
        ("", "Bearer rce_ann", 200),
        ("?userID=bob", "Bearer rce_ann", 401),
        ("", "Bearer rce_nobody", 401),
        ("", f"Basic {BASIC}", 200),
        ("", "Basic %%%", 401),
        ("", "Basic é", 401),
        ("?key=rce_ann", "", 200),
        ("?userID=ann&key=rce_ann", "", 200),
        ("?userID=ann&password=wrong", "", 401),
    ],
)
async def test_credentials(service: Service, query: str, header: str, status: int) -> None:
    headers = {"Authorization": header} if header else {}
    for path in ("/jobs", "/uploads"):
        answer = await service.session.get(service.url + path + query, headers=headers)
        assert answer.status == status
        assert ("WWW-Authenticate" in answer.headers) == (status == 401)


@pytest.mark.parametrize("header", [b"Authorization: Bearer \xff", b"Host: a b:c", b"Host: \xff"])
async def test_headers_that_cannot_be_read(service: Service, header: bytes) -> None:
    url = urlsplit(service.url)
    for more in (b"", b"Expect: 100-continue\r\n"):
        reader, writer = await asyncio.open_connection(url.hostname, url.port)
        host = b"" if header.startswith(b"Host") else b"Host: a\r\n"
        writer.write(b"POST /map-service/jobs HTTP/1.1\r\nContent-Length: 0\r\n" + host + more + header + b"\r\n\r\n")
        assert b" 400 " in await asyncio.wait_for(reader.readline(), 20)
        writer.close()


async def test_a_request_that_is_no_http_is_not_logged(service: Service, caplog: pytest.LogCaptureFixture) -> None:
    """Its line may have a key in it."""
    url = urlsplit(service.url)
    reader, writer = await asyncio.open_connection(url.hostname, url.port)
    writer.write(b"GET /map-service/jobs?key=rce_ann with spaces HTTP/1.1\r\n\r\n")
    assert b" 400 " in await asyncio.wait_for(reader.readline(), 20)
    writer.close()
    assert "rce_ann" not in caplog.text


async def test_a_proof_is_remembered_for_a_while(service: Service) -> None:
    for _ in range(3):
        assert (await service.ask("GET", "/jobs")).status == 200
    assert len(service.master.calls) == 1
    service.master.away = Unavailable("the Master is away")
    assert (await service.ask("GET", "/jobs")).status == 200
    answer = await service.ask("GET", "/jobs", "bob")
    assert (answer.status, (await answer.json())["code"]) == (503, "unavailable")


async def test_what_is_not_there(service: Service) -> None:
    for path in ("/nothing", "/jobs/x/y/z"):
        answer = await service.ask("GET", path)
        assert (answer.status, answer.content_type) == (404, "application/problem+json")
    assert (await service.ask("PUT", "/jobs")).status == 405
    assert (await service.ask("POST", "/jobs", data=b"x" * 100_000)).status == 413


async def test_the_document_is_openapi_and_names_every_route(service: Service) -> None:
    document: Any = await (await service.session.get(service.url + "/openapi.json")).json()
    OpenAPIV31SpecValidator(document).validate()
    described = {(method.upper(), path) for path, found in document["paths"].items() for method in found}
    routes = {
        (route.method, route.resource.canonical)
        for route in service.service._runner.app.router.routes()
        if route.resource is not None and "soap" not in route.resource.canonical
    }
    own = {
        (method, path)
        for method, path in routes
        if path.rstrip("/") not in ("/map-service", "/map-service/openapi.json", "/healthz", "/readyz")
    }
    assert described == own
    job = document["components"]["schemas"]["Job"]
    assert set(job["properties"]["state"]["enum"]) >= {"queued", "done"}
    assert document["components"]["schemas"]["MapOptions"]["properties"]["resolution"]["maximum"] == 0.5


async def test_a_service_that_starts_again_has_its_jobs(service: Service) -> None:
    job = await service.submit()
    await service.service.stop()
    await service.session.close()
    service.workers = type(service.workers)()
    await service.start()
    found = await (await service.ask("GET", f"/jobs/{job}")).json()
    assert found["state"] == "running"
    assert service.workers.task(job).former == [f"map_{job}_1"]


async def test_what_is_changed_is_told_for_the_audit_log(service: Service) -> None:
    job = await service.submit()
    upload = (await (await service.ask("GET", f"/jobs/{job}")).json())["uploads"][0]
    assert (await service.ask("DELETE", f"/jobs/{job}")).status == 400
    assert (await service.ask("POST", f"/jobs/{job}/cancel")).status == 200
    assert (await service.ask("POST", f"/jobs/{job}/cancel", "bob")).status == 404
    noted = [call for call in service.master.calls if isinstance(call, NoteDone)]
    assert [(call.person.user, call.action, call.object, call.result) for call in noted] == [
        ("ann", "upload.create", f"ann/{upload}", "ok"),
        ("ann", "job.submit", f"ann/{job}", "ok"),
        ("ann", "job.remove", f"ann/{job}", "invalid_request"),
        ("ann", "job.cancel", f"ann/{job}", "ok"),
        ("bob", "job.cancel", f"bob/{job}", "not_found"),
    ]
    assert {call.address for call in noted} == {"127.0.0.1"}


async def test_uploads_and_jobs_are_counted_for_metrics(service: Service) -> None:
    before = told(service)
    job = await service.submit()
    await service.ask("POST", f"/jobs/{job}/cancel")
    other = await service.submit("bob")
    service.workers.finish(other)
    await service.ask("GET", f"/jobs/{other}/events", "bob")  # until it is over
    after = told(service)
    assert after["rce_map_upload_bytes"][()] - before["rce_map_upload_bytes"].get((), 0) == 2 * len(LOG)
    assert after["rce_map_jobs"][("done",)] == 1
    assert after["rce_map_job_seconds"][("done",)] > before["rce_map_job_seconds"].get(("done",), 0)


def told(service: Service) -> dict[str, dict[tuple[str, ...], float]]:
    """What the service tells the Master, who tells Prometheus."""
    found = families("service", service.service.jobs.families)
    return {family.name: {tuple(each.labels): each.value for each in family.samples} for family in found}
