"""REST interface of the map service: authentication, errors, OpenAPI document, audit log and metrics."""

from __future__ import annotations

import asyncio
import base64
from typing import Any
from urllib.parse import urlsplit

import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator

from rce.control.calls.services import RecordAction
from rce.errors import Unavailable
from rce.process.metrics import collect_families
from tests.support.map_service import LOG, Service


async def test_health_needs_no_credentials(service: Service) -> None:
    root = service.url.removesuffix("/map-service")
    for path in ("/healthz", "/readyz"):
        async with service.session.get(root + path) as answer:
            assert (answer.status, await answer.json()) == (200, {"status": "ok", "missing": []})
    service.master.failure = Unavailable("no connection")
    async with service.session.get(root + "/readyz") as answer:
        assert answer.status == 503
        assert "Master" in (await answer.json())["missing"][0]


async def test_jobs_and_uploads_of_other_users_are_not_found(service: Service) -> None:
    job, upload = await service.submit(), await service.upload()
    for method, path in (
        *(("GET", f"/jobs/{job}"), ("GET", f"/jobs/{job}/events"), ("POST", f"/jobs/{job}/cancel")),
        *(("DELETE", f"/jobs/{job}"), ("GET", f"/uploads/{upload}"), ("DELETE", f"/uploads/{upload}")),
        ("GET", f"/jobs/{job}/files/log.txt"),
    ):
        assert (await service.request(method, path, "bob")).status == 404, path
    answer = await service.request("POST", "/jobs", "bob", json={"uploads": [upload]})
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
async def test_malformed_headers_are_refused(service: Service, header: bytes) -> None:
    url = urlsplit(service.url)
    for more in (b"", b"Expect: 100-continue\r\n"):
        reader, writer = await asyncio.open_connection(url.hostname, url.port)
        host = b"" if header.startswith(b"Host") else b"Host: a\r\n"
        writer.write(b"POST /map-service/jobs HTTP/1.1\r\nContent-Length: 0\r\n" + host + more + header + b"\r\n\r\n")
        assert b" 400 " in await asyncio.wait_for(reader.readline(), 20)
        writer.close()


async def test_malformed_request_line_is_not_logged(service: Service, caplog: pytest.LogCaptureFixture) -> None:
    """The line may contain an API key."""
    url = urlsplit(service.url)
    reader, writer = await asyncio.open_connection(url.hostname, url.port)
    writer.write(b"GET /map-service/jobs?key=rce_ann with spaces HTTP/1.1\r\n\r\n")
    assert b" 400 " in await asyncio.wait_for(reader.readline(), 20)
    writer.close()
    assert "rce_ann" not in caplog.text


async def test_authentication_is_cached(service: Service) -> None:
    for _ in range(3):
        assert (await service.request("GET", "/jobs")).status == 200
    assert len(service.master.calls) == 1
    service.master.failure = Unavailable("no connection to the Master")
    assert (await service.request("GET", "/jobs")).status == 200
    answer = await service.request("GET", "/jobs", "bob")
    assert (answer.status, (await answer.json())["code"]) == (503, "unavailable")


async def test_unknown_paths_and_methods_are_refused(service: Service) -> None:
    for path in ("/nothing", "/jobs/x/y/z"):
        answer = await service.request("GET", path)
        assert (answer.status, answer.content_type) == (404, "application/problem+json")
    assert (await service.request("PUT", "/jobs")).status == 405
    assert (await service.request("POST", "/jobs", data=b"x" * 100_000)).status == 413


async def test_openapi_document_describes_every_route(service: Service) -> None:
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


async def test_changes_are_recorded_in_the_audit_log(service: Service) -> None:
    job = await service.submit()
    upload = (await (await service.request("GET", f"/jobs/{job}")).json())["uploads"][0]
    assert (await service.request("DELETE", f"/jobs/{job}")).status == 400
    assert (await service.request("POST", f"/jobs/{job}/cancel")).status == 200
    assert (await service.request("POST", f"/jobs/{job}/cancel", "bob")).status == 404
    noted = [call for call in service.master.calls if isinstance(call, RecordAction)]
    assert [(call.identity.user, call.action, call.object, call.result) for call in noted] == [
        ("ann", "upload.create", f"ann/{upload}", "ok"),
        ("ann", "job.submit", f"ann/{job}", "ok"),
        ("ann", "job.remove", f"ann/{job}", "invalid_request"),
        ("ann", "job.cancel", f"ann/{job}", "ok"),
        ("bob", "job.cancel", f"bob/{job}", "not_found"),
    ]
    assert {call.address for call in noted} == {"127.0.0.1"}


async def test_metrics_of_uploads_and_jobs(service: Service) -> None:
    before = metric_values(service)
    job = await service.submit()
    await service.request("POST", f"/jobs/{job}/cancel")
    other = await service.submit("bob")
    service.runner.finish(other)
    await service.request("GET", f"/jobs/{other}/events", "bob")  # the event stream ends when the job is over
    after = metric_values(service)
    assert after["rce_map_upload_bytes"][()] - before["rce_map_upload_bytes"].get((), 0) == 2 * len(LOG)
    assert after["rce_map_jobs"][("done",)] == 1
    assert after["rce_map_job_seconds"][("done",)] > before["rce_map_job_seconds"].get(("done",), 0)


def metric_values(service: Service) -> dict[str, dict[tuple[str, ...], float]]:
    """Return the values of all metrics by name and labels."""
    found = collect_families("service", service.service.jobs.families)
    return {family.name: {tuple(each.labels): each.value for each in family.samples} for family in found}
