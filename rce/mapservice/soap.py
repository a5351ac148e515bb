"""SOAP 1.1 interface with the operations of RoboWS; the WSDL describes them."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import AsyncIterator, Awaitable, Callable
from datetime import UTC, datetime
from pathlib import Path

from aiohttp import web
from lxml import etree

from rce.api.map_jobs import PREFIX, Job, JobRequest
from rce.errors import InvalidRequest, LimitExceeded, RceError
from rce.mapservice.envelope import NAMESPACE, Envelopes, Request, add_texts, answer, fault, qualified_name
from rce.mapservice.jobs import Jobs
from rce.mapservice.pending_bodies import BUDGET, PendingBodies
from rce.mapservice.uploads import Uploads
from rce.services.auditing import ACTION, CLIENT, FAILED
from rce.services.authentication import KEY_PREFIX, Authenticator, Client
from rce.services.problems import convert, unexpected
from rce.web.server import logged_in

MAX_INLINE = 6 * 1024 * 1024  # bytes of a recording in a request; libxml2 accepts 10 MB of base64
MAX_RESULTS = 64 * 1024 * 1024  # bytes of the result files in an answer
XML = "text/xml"
PATH = PREFIX + "/soap"

AUDITED = {"SubmitMap": "job.submit", "CancelMap": "job.cancel"}
Operation = Callable[[Client, etree._Element, str], Awaitable[etree._Element]]


class Soap:
    """The SOAP handlers."""

    def __init__(self, authenticator: Authenticator, uploads: Uploads, jobs: Jobs) -> None:
        self._authenticator, self._uploads, self._jobs = authenticator, uploads, jobs
        self._envelopes = Envelopes()
        self._pending = PendingBodies(BUDGET)
        self._operations: dict[str, Operation] = {
            qualified_name("SubmitMap"): self._submit,
            qualified_name("GetStatus"): self._status,
            qualified_name("GetResult"): self._result,
            qualified_name("CancelMap"): self._cancel,
        }

    def add(self, application: web.Application) -> None:
        """Add the routes to an application."""
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
            except (RceError, ConnectionError):  # the latter: the client disconnected
                raise
            except web.HTTPRequestEntityTooLarge:
                raise LimitExceeded("the request is too large: upload the recording and submit its id") from None
            except web.HTTPException as error:
                raise InvalidRequest(error.text or error.reason) from None
            except Exception as error:  # noqa: BLE001  # the client gets an InternalError; the traceback goes to the log
                raise unexpected(error, "SOAP") from None
        except RceError as error:  # SOAP 1.1 requires status 500 for every fault
            request[FAILED] = error.info.code
            return web.Response(status=500, body=fault(error), content_type=XML, charset="utf-8")
        return web.Response(body=body, content_type=XML, charset="utf-8")

    async def _perform(self, request: web.Request) -> bytes:
        async with self._pending.read(request) as content:
            parsed = self._envelopes.read(content)
            reads = etree.QName(parsed.body).localname.startswith(("Get", "List"))
            client = await self._client(request, parsed, "job.read" if reads else "job.submit")
        operation = self._operations.get(str(parsed.body.tag))
        if operation is None:
            raise InvalidRequest(f"there is no operation {etree.QName(parsed.body).localname}", field="Body")
        found = await operation(client, parsed.body, str(request.url.origin()))
        self._envelopes.check(found)
        return answer(found)

    async def _client(self, request: web.Request, parsed: Request, operation: str) -> Client:
        query = {"userID": parsed.user, _kind(parsed.secret): parsed.secret} if parsed.secret else request.query
        headers = {} if parsed.secret else request.headers
        client = await self._authenticator.authenticate(headers, query, operation, request.remote or "")
        logged_in()
        request[CLIENT] = client
        request[ACTION] = AUDITED.get(etree.QName(parsed.body).localname, "")
        return client

    async def _submit(self, client: Client, body: etree._Element, origin: str) -> etree._Element:
        given = body.find(qualified_name("options"))
        options = (
            {etree.QName(each).localname: (each.text or "").strip() for each in given} if given is not None else {}
        )
        names = [each.text for each in body.iterfind(qualified_name("upload"))]
        inline = body.find(qualified_name("recording"))
        if inline is not None:
            names = [await self._store(client, inline)]
        request = convert({"uploads": names, "options": options}, JobRequest)
        try:
            job = await self._jobs.submit(client.user, client.secret, request)
        except BaseException:
            if inline is not None and not self._jobs.uses(str(names[0])):
                await self._uploads.remove(client.user, str(names[0]))
            raise
        return _with_job("SubmitMapResponse", job)

    async def _store(self, client: Client, recording: etree._Element) -> str:
        """Store the recording of a request as an upload; return its id."""
        try:
            content = base64.b64decode(recording.findtext(qualified_name("content"), ""))
        except ValueError as error:
            raise InvalidRequest(f"the content of the recording is not base64: {error}", field="content") from None
        if len(content) > MAX_INLINE:
            text = f"a request can have a recording of at most {MAX_INLINE} bytes: upload it and submit its id"
            raise LimitExceeded(text, field="content", limit=MAX_INLINE, asked=len(content))
        upload = self._uploads.create(client.user, recording.findtext(qualified_name("name"), ""), len(content))

        async def pieces() -> AsyncIterator[bytes]:
            yield content

        return (await self._uploads.append(client.user, upload.id, 0, pieces())).id

    async def _status(self, client: Client, body: etree._Element, origin: str) -> etree._Element:
        return _with_job("GetStatusResponse", self._jobs.get(client.user, _job(body)))

    async def _cancel(self, client: Client, body: etree._Element, origin: str) -> etree._Element:
        return _with_job("CancelMapResponse", self._jobs.cancel(client.user, _job(body)))

    async def _result(self, client: Client, body: etree._Element, origin: str) -> etree._Element:
        job = self._jobs.get(client.user, _job(body))
        wanted = {each.text or "": Path() for each in body.iterfind(qualified_name("file"))}
        wanted = {name: self._jobs.file(client.user, job.id, name) for name in wanted}
        size = sum(path.stat().st_size for path in wanted.values())
        if size > MAX_RESULTS:
            text = f"these files have {size} bytes, but an answer can have {MAX_RESULTS}: download them by their url"
            raise LimitExceeded(text, field="file", limit=MAX_RESULTS, asked=size)
        answer = _with_job("GetResultResponse", job)
        for file in job.files:
            element = etree.SubElement(answer, qualified_name("file"))
            add_texts(element, name=file.name, size=file.size, url=f"{origin}{PREFIX}/jobs/{job.id}/files/{file.name}")
            if file.name in wanted:
                content = await asyncio.to_thread(wanted[file.name].read_bytes)
                add_texts(element, content=base64.b64encode(content).decode())
        return answer


def _kind(secret: str) -> str:
    return "key" if secret.startswith(KEY_PREFIX) else "password"


def _job(body: etree._Element) -> str:
    return str(body.findtext(qualified_name("job"), "")).strip()


def _with_job(name: str, job: Job) -> etree._Element:
    answer = etree.Element(qualified_name(name), nsmap={"tns": NAMESPACE})
    element = etree.SubElement(answer, qualified_name("job"))
    add_texts(
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
        problem = etree.SubElement(element, qualified_name("error"))
        add_texts(problem, code=job.error.code, message=job.error.message, field=job.error.field or None)
    return answer


def _time(stamp: float | None) -> str | None:
    return None if stamp is None else datetime.fromtimestamp(stamp, UTC).isoformat(timespec="milliseconds")
