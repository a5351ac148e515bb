"""Audit log of the changes that clients make."""

from __future__ import annotations

import base64
import errno

import pytest

from rce.control.calls.services import RecordAction
from rce.services.record_store import RecordStore
from tests.support.map_service import Service
from tests.support.soap import envelope


def recorded(service: Service) -> list[tuple[str, str, str]]:
    """Return action, object and result of each record."""
    calls = [call for call in service.master.calls if isinstance(call, RecordAction)]
    return [(call.action, call.object, call.result) for call in calls]


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


async def test_reading_is_not_recorded(service: Service) -> None:
    job = await service.submit()
    before = recorded(service)
    for path in ("/jobs", "/uploads", f"/jobs/{job}", "/nothing"):
        await service.request("GET", path)
    assert recorded(service) == before


async def test_request_without_valid_credentials_is_not_recorded(service: Service) -> None:
    """There is no user whose action it would be; the Master records failed logins itself."""
    assert (await service.request("POST", "/jobs", "nobody")).status == 401
    assert recorded(service) == []


async def test_change_that_fails_unexpectedly_is_recorded(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(RecordStore, "put", full)
    filename = base64.b64encode(b"a.log").decode()
    headers = {"Upload-Length": "9", "Upload-Metadata": f"filename {filename}"}
    assert (await service.request("POST", "/uploads", headers=headers)).status == 503
    assert recorded(service) == [("upload.create", "ann", "unavailable")]


async def test_soap_operations_are_recorded(service: Service) -> None:
    async def post(body: str) -> None:
        await service.request("POST", "/soap", data=envelope(body), headers={"Content-Type": "text/xml"})

    upload = await service.upload()
    await post(f"<r:SubmitMap><r:upload>{upload}</r:upload></r:SubmitMap>")
    await post(f"<r:CancelMap><r:job>{'0' * 24}</r:job></r:CancelMap>")
    await post(f"<r:GetStatus><r:job>{'0' * 24}</r:job></r:GetStatus>")
    actions = [(action, result) for action, _, result in recorded(service)]
    assert actions == [("upload.create", "ok"), ("job.submit", "ok"), ("job.cancel", "not_found")]
