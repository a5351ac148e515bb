"""The same operations in SOAP 1.1, as RoboWS offered them to robots of all kinds; the WSDL says what each takes."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import AsyncIterator, Awaitable, Callable
from datetime import UTC, datetime
from pathlib import Path

from aiohttp import web
from lxml import etree

from rce.errors import InvalidRequest, LimitExceeded, RceError
from rce.map_jobs import PREFIX, Job, JobRequest
from rce.mapservice.access import Access, Client
from rce.mapservice.envelope import Envelopes, Request, answer, fault, own, texts
from rce.mapservice.jobs import Jobs
from rce.mapservice.noting import ACTION, CLIENT, FAILED
from rce.mapservice.problems import convert, unexpected
from rce.mapservice.uploads import Uploads

INLINE_MOST = 6 * 1024 * 1024  # bytes of a recording that comes along; libxml2 takes 10 MB of base64
RESULTS_MOST = 64 * 1024 * 1024  # bytes of the results that come along
XML = "text/xml"
PATH = PREFIX + "/soap"

NOTED = {"SubmitMap": "job.submit", "CancelMap": "job.cancel"}
Operation = Callable[[Client, etree._Element, str], Awaitable[etree._Element]]


class Soap:
    """The SOAP handlers."""

    def __init__(self, access: Access, uploads: Uploads, jobs: Jobs) -> None:
        self._access, self._uploads, self._jobs = access, uploads, jobs
        self._envelopes = Envelopes()
        self._operations: dict[str, Operation] = {
            own("SubmitMap"): self._submit,
            own("GetStatus"): self._status,
            own("GetResult"): self._result,
            own("CancelMap"): self._cancel,
        }

    def add(self, application: web.Application) -> None:
        application.router.add_get(PATH, self._describe)
        application.router.add_post(PATH, self._handle)

    async def _describe(self, request: web.Request) -> web.Response:
        return web.Response(
            body=self._envelopes.wsdl(f"{request.url.origin()}{PATH}"), content_type=XML, charset="utf-8"
        )

    async def _handle(self, request: web.Request) -> web.Response:
        try:
            try:
                body = await self._perform(request)
            except RceError:
                raise
            except web.HTTPRequestEntityTooLarge:
                raise LimitExceeded("the request is too large: upload the recording, and submit its id") from None
            except Exception as error:  # noqa: BLE001  # the client hears of a defect; the traceback stays in the log
                raise unexpected(error, "SOAP") from None
        except RceError as error:  # SOAP 1.1 wants 500 for every fault
            request[FAILED] = error.info.code
            return web.Response(status=500, body=fault(error), content_type=XML, charset="utf-8")
        return web.Response(body=body, content_type=XML, charset="utf-8")

    async def _perform(self, request: web.Request) -> bytes:
        asked = self._envelopes.read(await request.read())
        reads = etree.QName(asked.body).localname.startswith(("Get", "List"))
        client = await self._client(request, asked, "job.read" if reads else "job.submit")
        operation = self._operations.get(str(asked.body.tag))
        if operation is None:
            raise InvalidRequest(f"there is no operation {etree.QName(asked.body).localname}", field="Body")
        found = await operation(client, asked.body, str(request.url.origin()))
        self._envelopes.check(found)
        return answer(found)

    async def _client(self, request: web.Request, asked: Request, operation: str) -> Client:
        query = {"userID": asked.user, _kind(asked.secret): asked.secret} if asked.secret else request.query
        headers = {} if asked.secret else request.headers
        client = await self._access.client(headers, query, operation, request.remote or "")
        request[CLIENT] = client
        request[ACTION] = NOTED.get(etree.QName(asked.body).localname, "")
        return client

    async def _submit(self, client: Client, body: etree._Element, origin: str) -> etree._Element:
        given = body.find(own("options"))
        options = (
            {etree.QName(each).localname: (each.text or "").strip() for each in given} if given is not None else {}
        )
        names = [each.text for each in body.iterfind(own("upload"))]
        inline = body.find(own("recording"))
        if inline is not None:
            names = [await self._take(client, inline)]
        request = convert({"uploads": names, "options": options}, JobRequest)
        try:
            job = await self._jobs.submit(client.user, client.secret, request)
        except BaseException:
            if inline is not None and not self._jobs.uses(str(names[0])):
                await self._uploads.remove(client.user, str(names[0]))
            raise
        return _with_job("SubmitMapResponse", job)

    async def _take(self, client: Client, recording: etree._Element) -> str:
        """Store a recording that came along; the id of the upload."""
        content = base64.b64decode(recording.findtext(own("content"), ""))
        if len(content) > INLINE_MOST:
            text = f"a recording of more than {INLINE_MOST} bytes cannot come along: upload it, and submit its id"
            raise LimitExceeded(text, field="content", limit=INLINE_MOST, asked=len(content))
        upload = self._uploads.create(client.user, recording.findtext(own("name"), ""), len(content))

        async def pieces() -> AsyncIterator[bytes]:
            yield content

        return (await self._uploads.append(client.user, upload.id, 0, pieces())).id

    async def _status(self, client: Client, body: etree._Element, origin: str) -> etree._Element:
        return _with_job("GetStatusResponse", self._jobs.get(client.user, _job(body)))

    async def _cancel(self, client: Client, body: etree._Element, origin: str) -> etree._Element:
        return _with_job("CancelMapResponse", self._jobs.cancel(client.user, _job(body)))

    async def _result(self, client: Client, body: etree._Element, origin: str) -> etree._Element:
        job = self._jobs.get(client.user, _job(body))
        wanted = {each.text or "": Path() for each in body.iterfind(own("file"))}
        wanted = {name: self._jobs.file(client.user, job.id, name) for name in wanted}
        size = sum(path.stat().st_size for path in wanted.values())
        if size > RESULTS_MOST:
            text = f"these files have {size} bytes, and {RESULTS_MOST} can come along: fetch them by their url"
            raise LimitExceeded(text, field="file", limit=RESULTS_MOST, asked=size)
        answer = _with_job("GetResultResponse", job)
        for file in job.files:
            element = etree.SubElement(answer, own("file"))
            texts(element, name=file.name, size=file.size, url=f"{origin}{PREFIX}/jobs/{job.id}/files/{file.name}")
            if file.name in wanted:
                content = await asyncio.to_thread(wanted[file.name].read_bytes)
                texts(element, content=base64.b64encode(content).decode())
        return answer


def _kind(secret: str) -> str:
    return "key" if secret.startswith("rce_") else "password"


def _job(body: etree._Element) -> str:
    return str(body.findtext(own("job"), "")).strip()


def _with_job(name: str, job: Job) -> etree._Element:
    answer = etree.Element(own(name), nsmap={"tns": "urn:rce:robows:1"})
    element = etree.SubElement(answer, own("job"))
    texts(
        element,
        id=job.id,
        state=job.state,
        recording=job.recording,
        stage=job.stage,
        scans=job.scans,
        total=job.total,
        created=_time(job.created),
        started=_time(job.started),
        ended=_time(job.ended),
    )
    if job.error is not None:
        problem = etree.SubElement(element, own("error"))
        texts(problem, code=job.error.code, message=job.error.message, field=job.error.field or None)
    return answer


def _time(stamp: float | None) -> str | None:
    return None if stamp is None else datetime.fromtimestamp(stamp, UTC).isoformat(timespec="milliseconds")
