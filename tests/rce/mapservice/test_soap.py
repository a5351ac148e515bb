"""SOAP 1.1 interface, with XML that client libraries would not send."""

from __future__ import annotations

import asyncio
import base64
import hashlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from aiohttp import web
from lxml import etree

from rce.control.calls.services import Authenticate
from rce.mapservice import pending_bodies, soap
from tests.support.map_service import LOG, Service
from tests.support.soap import NAMES, envelope, username_token


async def post(service: Service, text: str | bytes, user: str = "ann") -> tuple[int, etree._Element]:
    headers = {"Content-Type": "text/xml; charset=utf-8", "SOAPAction": '""'}
    answer = await service.request("POST", "/soap", user, data=text, headers=headers)
    assert answer.content_type == "text/xml"
    return answer.status, etree.fromstring(await answer.read())


def fault(answer: etree._Element) -> tuple[str, str, str]:
    """Return the fault code, our error code and the field."""
    found = answer.find("s:Body/s:Fault", NAMES)
    assert found is not None
    problem = "detail/r:Problem/r:"
    return (
        found.findtext("faultcode", ""),
        found.findtext(problem + "code", "", NAMES),
        found.findtext(problem + "field", "", NAMES),
    )


def inline(content: bytes = LOG, name: str = "a.log", options: str = "") -> str:
    data = base64.b64encode(content).decode()
    recording = f"<r:recording><r:name>{name}</r:name><r:content>{data}</r:content></r:recording>"
    return f"<r:SubmitMap>{recording}{options}</r:SubmitMap>"


async def test_request_with_a_recording_and_answer_with_a_result(service: Service) -> None:
    given = "<r:max_range>20</r:max_range><r:resolution> 0.2 </r:resolution><r:parallel>3</r:parallel>"
    options = f"<r:options>{given}</r:options>"
    status, answer = await post(service, envelope(inline(options=options)))
    assert status == 200
    job = answer.findtext(".//r:id", "", NAMES)
    task = service.runner.task(job)
    assert (task.options.max_range, task.options.resolution, task.options.parallel) == (20.0, 0.2, 3)
    service.runner.finish(job)
    async with asyncio.timeout(20):  # the event stream ends when the job is over
        await service.request("GET", f"/jobs/{job}/events")
    request = f"<r:GetResult><r:job>{job}</r:job><r:file>map.png</r:file></r:GetResult>"
    _, answer = await post(service, envelope(request))
    files = {file.findtext("r:name", "", NAMES): file for file in answer.iterfind(".//r:file", NAMES)}
    assert set(files) == {"log.txt", "map.png", "times.json"}
    assert base64.b64decode(files["map.png"].findtext("r:content", "", NAMES)) == b"a picture"
    assert files["log.txt"].find("r:content", NAMES) is None
    assert (await service.request("GET", files["log.txt"].findtext("r:url", "", NAMES))).status == 200


async def test_client_that_disconnects_is_no_defect(
    service: Service, failures: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def lost(request: web.Request) -> AsyncIterator[bytes]:
        raise ConnectionResetError("Connection lost")
        yield b""

    monkeypatch.setattr(pending_bodies, "body_pieces", lost)
    await service.request("POST", "/soap", "ann", data=envelope(""))
    assert not failures


async def test_job_of_an_upload_with_status_and_cancellation(service: Service) -> None:
    upload = await service.upload()
    _, answer = await post(service, envelope(f"<r:SubmitMap><r:upload>{upload}</r:upload></r:SubmitMap>"))
    job = answer.findtext(".//r:id", "", NAMES)
    _, answer = await post(service, envelope(f"<r:GetStatus><r:job>{job}</r:job></r:GetStatus>"))
    assert answer.findtext(".//r:state", "", NAMES) == "running"
    _, answer = await post(service, envelope(f"<r:CancelMap><r:job>{job}</r:job></r:CancelMap>"))
    assert answer.findtext(".//r:state", "", NAMES) == "cancelling"


NONE = "0" * 24
STRANGE = '<x:Y xmlns:x="x" s:mustUnderstand="1"/>'
WRONG = "<r:options><r:resolution>9</r:resolution></r:options>"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("no xml", ("soap:Client", "invalid_request", "")),
        ("<a/>", ("soap:Client", "invalid_request", "Envelope")),
        (envelope(""), ("soap:Client", "invalid_request", "Body")),
        (envelope("<r:DropTables/>"), ("soap:Client", "invalid_request", "DropTables")),
        (envelope("<r:SubmitMapResponse/>"), ("soap:Client", "invalid_request", "SubmitMapResponse")),
        (envelope("<r:GetStatus/>"), ("soap:Client", "invalid_request", "GetStatus")),
        (envelope("<r:GetStatus><r:job>../x</r:job></r:GetStatus>"), ("soap:Client", "invalid_request", "job")),
        (envelope(f"<r:GetStatus><r:job>{NONE}</r:job></r:GetStatus>"), ("soap:Client", "not_found", "")),
        (
            envelope(f"<r:SubmitMap><r:upload>{NONE}</r:upload>{WRONG}</r:SubmitMap>"),
            ("soap:Client", "invalid_request", "options.resolution"),
        ),
        (envelope(inline(b"PK", "a.bag")), ("soap:Client", "invalid_request", "body")),
        (
            envelope("<r:GetStatus/>", '<x:Y xmlns:x="x" s:mustUnderstand="1"/>'),
            ("soap:MustUnderstand", "invalid_request", ""),
        ),
    ],
)
async def test_wrong_requests_are_answered_with_faults(
    service: Service, text: str, expected: tuple[str, str, str]
) -> None:
    status, answer = await post(service, text)
    assert status == 500
    assert fault(answer) == expected
    assert service.service.uploads.of("ann") == []


@pytest.mark.parametrize("content", ["QUJD\u00e9", "QUJ", "="])  # libxml2 lets stray characters pass
async def test_content_that_is_no_base64_is_refused(service: Service, content: str) -> None:
    recording = f"<r:recording><r:name>a.log</r:name><r:content>{content}</r:content></r:recording>"
    _, answer = await post(service, envelope(f"<r:SubmitMap>{recording}</r:SubmitMap>"))
    assert fault(answer)[:2] == ("soap:Client", "invalid_request")


async def test_deep_and_large_requests_are_refused(service: Service) -> None:
    _, answer = await post(service, envelope("<r:x>" * 5000))
    assert fault(answer)[0] == "soap:Client"
    _, answer = await post(service, b"x" * 10_000_000)
    assert fault(answer)[:2] == ("soap:Client", "limit_exceeded")
    _, answer = await post(service, envelope(inline(bytes(6_400_000), "a.bag")))
    assert fault(answer)[:2] == ("soap:Client", "limit_exceeded")


async def test_username_token_authenticates(service: Service) -> None:
    request = f"<r:GetStatus><r:job>{NONE}</r:job></r:GetStatus>"
    _, answer = await post(service, envelope(request, username_token("rce_ann", "PasswordText")), "nobody")
    assert fault(answer)[1] == "not_found"
    _, answer = await post(service, envelope(request, username_token("secret")), "nobody")
    assert fault(answer)[:2] == ("soap:Client", "unauthorized")
    call = Authenticate("ann", hashlib.sha256(b"secret").hexdigest(), "job.read", "127.0.0.1")
    assert call in service.master.calls
    _, answer = await post(service, envelope(request, username_token("x", "PasswordDigest")), "nobody")
    assert fault(answer)[:2] == ("soap:Client", "unauthorized")


async def test_bodies_of_strangers_share_a_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soap, "BUDGET", 10_000)
    service = Service(tmp_path)
    await service.start()
    status, answer = await post(service, envelope(inline(bytes(20_000))))
    assert (status, fault(answer)[1]) == (500, "unavailable")
    status, answer = await post(service, envelope("<r:GetStatus><r:job>1</r:job></r:GetStatus>"))
    assert (status, fault(answer)[1]) == (500, "not_found")
    await service.stop()
