"""Map service as a whole: its server, the calls of the Master, and what it removes from time to time."""

from __future__ import annotations

import asyncio
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from twisted.logger import LogEvent

from rce.control.calls.services import Authenticate, InvalidateAuthentication
from rce.errors import Unavailable
from rce.mapservice.server import MapService
from rce.mapservice.uploads import Uploads
from rce.process.metrics import collect_families
from rce.web import requests, server
from tests.support.control import answer
from tests.support.map_service import LIMITS, LOG, FakeRunner, Service


async def test_malformed_request_line_is_not_logged(service: Service, caplog: pytest.LogCaptureFixture) -> None:
    """The line may contain an API key."""
    url = urlsplit(service.url)
    reader, writer = await asyncio.open_connection(url.hostname, url.port)
    writer.write(b"GET /map-service/jobs?key=rce_ann with spaces HTTP/1.1\r\n\r\n")
    assert b" 400 " in await asyncio.wait_for(reader.readline(), 20)
    writer.close()
    assert "rce_ann" not in caplog.text


async def raw(service: Service, request: bytes) -> bytes:
    """Send bytes and return all that comes until the service closes the connection."""
    url = urlsplit(service.url)
    reader, writer = await asyncio.open_connection(url.hostname, url.port)
    writer.write(request)
    try:
        return await asyncio.wait_for(reader.read(), 20)
    except ConnectionResetError:
        return b""
    finally:
        writer.close()


@pytest.mark.parametrize("request_line", [b"GET x", b"GET http://[", b"GET *", b"CONNECT [", b"GET x:y", b"GET ?q"])
async def test_malformed_target_is_refused(service: Service, request_line: bytes) -> None:
    answer = await raw(service, request_line + b" HTTP/1.1\r\nHost: x\r\n\r\n")
    assert b" 400 " in answer
    assert b"Traceback" not in answer


async def test_silent_connection_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(server.LIMITS, "keepalive_timeout", 0.1)
    service = Service(tmp_path)
    await service.start()
    assert await raw(service, b"") == b""
    assert await raw(service, b"GET / HTTP/1.1\r\nHost") == b""
    await service.stop()


@pytest.mark.parametrize(
    ("method", "path"),
    [("POST", "/jobs"), ("POST", "/uploads?filename=a.log"), ("POST", "/soap"), ("DELETE", "/jobs/1")],
)
@pytest.mark.parametrize("header", [{"Origin": "https://evil.example"}, {"Sec-Fetch-Site": "cross-site"}])
async def test_page_of_another_site_changes_nothing(
    service: Service, method: str, path: str, header: dict[str, str]
) -> None:
    """With a password that the browser keeps, as the user `ann` would have entered it."""
    kept = {"Authorization": "Basic YW5uOmFubg==", "Content-Type": "text/plain"}
    answer = await service.request(method, path, data=b"{}", headers=kept | header)
    assert answer.status == 403
    assert "page of another site" in await answer.text()
    assert service.service.uploads.of("ann") == []
    assert service.master.calls == []


async def test_silent_body_is_refused_in_time(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "BODY_TIMEOUT", 0.1)
    headers = "Authorization: Bearer rce_ann\r\nContent-Type: application/offset+octet-stream\r\nContent-Length: 9"
    heads = [
        f"POST /map-service{path} HTTP/1.1\r\nHost: x\r\n{headers}\r\n\r\n".encode()
        for path in ("/jobs", "/uploads?filename=a.log", "/soap")
    ]
    for answered in await asyncio.gather(*(raw(service, head) for head in heads)):
        assert b"came too slowly" in answered


@pytest.mark.parametrize("path", ["/jobs", "/uploads?filename=a.log", "/soap"])
@pytest.mark.parametrize("encoding", ["gzip", "deflate", "br", "zstd", "nonsense"])
async def test_compressed_body_is_refused(service: Service, path: str, encoding: str) -> None:
    headers = {"Content-Encoding": encoding, "Content-Type": "application/offset+octet-stream"}
    answer = await service.request("POST", path, data=b"abc", headers=headers)
    assert answer.status == 415
    assert answer.headers["Accept-Encoding"] == "identity"
    assert service.service.uploads.of("ann") == []


@pytest.mark.parametrize("path", ["/jobs", "/uploads?filename=a.log", "/soap"])
async def test_malformed_chunked_body_is_refused(service: Service, path: str, failures: list[LogEvent]) -> None:
    headers = (
        "Authorization: Bearer rce_ann\r\nUpload-Length: 9\r\nContent-Type: application/offset+octet-stream\r\n"
        "Transfer-Encoding: chunked"
    )
    body = "1\r\na\r\nzz\r\n"
    answer = await raw(service, f"POST /map-service{path} HTTP/1.1\r\nHost: x\r\n{headers}\r\n\r\n{body}".encode())
    assert b" 400 " in answer or (path == "/soap" and b"soap:Client" in answer)
    assert not failures


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


async def test_master_can_invalidate_the_authentication_of_a_user(service: Service) -> None:
    for _ in range(2):
        await service.request("GET", "/jobs")
    await answer(service.service.handlers(), InvalidateAuthentication("ann"))
    await service.request("GET", "/jobs")
    assert len([call for call in service.master.calls if isinstance(call, Authenticate)]) == 2


async def test_port_in_use_is_refused(service: Service, tmp_path: Path) -> None:
    other = MapService(tmp_path / "other", lambda: service.master, FakeRunner(), LIMITS, "http://entry/")
    with pytest.raises(Unavailable):
        await other.start("127.0.0.1", urlsplit(service.url).port or 0)
    await other.stop()


async def test_expired_uploads_are_removed_when_the_service_starts(tmp_path: Path) -> None:
    earlier = Uploads(tmp_path / "uploads", LIMITS.uploads, lambda _: 0, lambda: 0.0)
    upload = earlier.create("ann", "a.log", 4).id
    service = Service(tmp_path)
    await service.start()
    async with asyncio.timeout(20):
        while earlier.path(upload).exists():
            await service.request("GET", "/uploads")  # meanwhile the service works
    assert (await service.request("HEAD", f"/uploads/{upload}")).status == 404
    await service.stop()
