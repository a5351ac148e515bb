"""REST interface of the map service: uploads."""

from __future__ import annotations

import asyncio
import base64
import errno

import pytest

from rce.mapservice import uploads
from rce.services.record_store import RecordStore
from tests.support.map_service import LOG, Service

CHUNK = {"Content-Type": "application/offset+octet-stream"}
TUS = {"Tus-Resumable": "1.0.0"}


def metadata(name: str) -> dict[str, str]:
    return {"Upload-Metadata": f"filename {base64.b64encode(name.encode()).decode()}"}


async def test_tus_upload_in_several_requests(service: Service) -> None:
    answer = await service.request("OPTIONS", "/uploads")
    assert (answer.status, answer.headers["Tus-Version"], answer.headers["Tus-Max-Size"]) == (204, "1.0.0", "10000000")
    length = {"Upload-Length": str(len(LOG))}
    answer = await service.request("POST", "/uploads", headers={**TUS, **length, **metadata("a.log")})
    assert (answer.status, answer.headers["Upload-Offset"]) == (201, "0")
    place = answer.headers["Location"]
    answer = await service.request("PATCH", place, headers={**TUS, **CHUNK, "Upload-Offset": "0"}, data=LOG[:100])
    assert (answer.status, answer.headers["Upload-Offset"]) == (204, "100")
    answer = await service.request("PATCH", place, headers={**TUS, **CHUNK, "Upload-Offset": "0"}, data=LOG)
    assert answer.status == 409
    answer = await service.request("HEAD", place, headers=TUS)
    assert (answer.status, answer.headers["Upload-Offset"]) == (200, "100")
    assert answer.headers["Upload-Length"] == str(len(LOG))
    assert answer.headers["Cache-Control"] == "no-store"
    answer = await service.request("PATCH", place, headers={**TUS, **CHUNK, "Upload-Offset": "100"}, data=LOG[100:])
    assert (answer.status, answer.headers["Upload-Offset"]) == (204, str(len(LOG)))
    assert [upload["name"] for upload in await (await service.request("GET", "/uploads")).json()] == ["a.log"]
    assert (await service.request("DELETE", place, headers=TUS)).status == 204
    assert (await service.request("HEAD", place)).status == 404


async def test_received_data_is_kept_when_the_connection_breaks(service: Service) -> None:
    headers = {**TUS, "Upload-Length": str(len(LOG)), **metadata("a.log")}
    place = (await service.request("POST", "/uploads", headers=headers)).headers["Location"]
    host, port = place.split("/")[2].split(":")
    _, writer = await asyncio.open_connection(host, int(port))
    lines = [f"PATCH {place} HTTP/1.1", "Host: x", "Authorization: Bearer rce_ann", "Upload-Offset: 0"]
    lines += [f"Content-Type: {CHUNK['Content-Type']}", f"Content-Length: {len(LOG)}"]
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
    offset = int((await service.request("HEAD", place)).headers["Upload-Offset"])
    assert 0 <= offset <= 300
    answer = await service.request("PATCH", place, headers={**CHUNK, "Upload-Offset": str(offset)}, data=LOG[offset:])
    assert answer.status == 204
    assert uploads.path(name).read_bytes() == LOG


@pytest.mark.parametrize(
    ("user", "upload", "status"),
    [("ann", "", "100"), ("nobody", "", "401"), ("ann", "0" * 24, "404"), ("bob", "", "404")],
)
async def test_expect_continue_is_answered_before_the_body(
    service: Service, user: str, upload: str, status: str
) -> None:
    name = upload or service.service.uploads.create("ann", "a.log", len(LOG)).id
    host, port = service.url.split("/")[2].split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    lines = [f"PATCH /map-service/uploads/{name} HTTP/1.1", "Host: x", f"Authorization: Bearer rce_{user}"]
    lines += ["Expect: 100-continue", "Upload-Offset: 0", f"Content-Type: {CHUNK['Content-Type']}"]
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
async def test_wrong_upload_requests_are_refused(
    service: Service, headers: dict[str, str], status: int, field: str
) -> None:
    answer = await service.request("POST", "/uploads", headers=headers)
    assert (answer.status, answer.content_type) == (status, "application/problem+json")
    problem = await answer.json()
    assert (problem["status"], problem["field"]) == (status, field)
    assert problem["detail"]


async def test_other_files_are_refused_by_their_first_bytes(service: Service) -> None:
    answer = await service.request(
        "POST", "/uploads?filename=a.bag", headers=CHUNK, data=b"#ROSBAG V1.2\n" + bytes(9000)
    )
    assert answer.status == 400
    assert "1.2" in (await answer.json())["detail"]
    assert await (await service.request("GET", "/uploads")).json() == []


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


async def test_full_disk_is_reported_and_the_upload_can_be_resumed(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    headers = {"Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"}
    announced = await service.request("POST", "/uploads", headers={"Upload-Length": str(len(LOG))} | metadata("a.log"))
    place = announced.headers["Location"]
    monkeypatch.setattr(uploads, "_write_all", full)
    refused = await service.request("PATCH", place, data=LOG, headers=headers)
    assert refused.status == 503
    assert (await refused.json())["code"] == "unavailable"
    assert "disk" in (await refused.json())["detail"]
    monkeypatch.undo()
    assert (await service.request("PATCH", place, data=LOG, headers=headers)).status == 204


async def test_nothing_is_created_if_its_record_cannot_be_written(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    upload = await service.upload()
    monkeypatch.setattr(RecordStore, "put", full)
    announced = await service.request("POST", "/uploads", headers={"Upload-Length": "9"} | metadata("b.log"))
    submitted = await service.request("POST", "/jobs", json={"uploads": [upload]})
    assert [announced.status, submitted.status] == [503, 503]
    assert [each["id"] for each in await (await service.request("GET", "/uploads")).json()] == [upload]
    assert await (await service.request("GET", "/jobs")).json() == []
    assert service.master.grants == {}, "the grant is revoked"
    assert not list((service.directory / "jobs").iterdir())
