"""REST interface: uploads (tus 1.0), and jobs with their progress and result files."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from email.utils import formatdate
from typing import Any

import msgspec
from aiohttp import web
from twisted.logger import Logger

from rce.api.map_jobs import PREFIX, JobRequest, PlanRequest, Upload
from rce.errors import Forbidden, InvalidRequest, NotFound, TimedOut, Unauthorized
from rce.mapservice.jobs import Jobs
from rce.mapservice.plans import Plans
from rce.mapservice.uploads import Uploads
from rce.services.auditing import CLIENT
from rce.services.authentication import Authenticator, Client
from rce.services.problems import TOO_LARGE, decode
from rce.web import tus
from rce.web.problems import HttpError
from rce.web.requests import body_pieces, read_accepted_body
from rce.web.server import logged_in

EXTENSIONS = "creation,creation-with-upload,expiration,termination"
MAX_REQUEST = 64 * 1024  # bytes of a JSON body
HEARTBEAT = 15.0  # seconds without an event until a comment is sent
TYPES = {
    ".pgm": "image/x-portable-graymap",
    ".png": "image/png",
    ".yaml": "application/yaml",
    ".json": "application/json",
}
log = Logger()


class Rest:
    """Request handlers. Each authenticates the client first."""

    def __init__(self, authenticator: Authenticator, uploads: Uploads, jobs: Jobs, plans: Plans) -> None:
        self._authenticator, self._uploads, self._jobs, self._plans = authenticator, uploads, jobs, plans

    async def _client(self, request: web.Request) -> Client:
        reads = request.method in ("GET", "HEAD") or request.path.endswith("/plan")
        operation = "job.read" if reads else "job.submit"
        client = await self._authenticator.authenticate(request.headers, request.query, operation, request.remote or "")
        logged_in()
        request[CLIENT] = client
        return client

    async def check_expectation(self, request: web.Request) -> None:
        """Check a request with `Expect: 100-continue` before its body is sent; raise RceError if it is wrong."""
        await self._client(request)
        upload = request.match_info.get("upload")
        if upload is not None and request.method == "PATCH":
            await self.show_upload(request)

    # --- uploads -----------------------------------------------------------------------------------------------------

    async def tus_options(self, request: web.Request) -> web.Response:
        """Answer OPTIONS with the supported version and extensions of tus."""
        headers = {"Tus-Version": tus.VERSION, "Tus-Extension": EXTENSIONS, "Tus-Max-Size": str(self._uploads.largest)}
        return web.Response(status=204, headers=tus.answer_headers(headers))

    async def create_upload(self, request: web.Request) -> web.Response:
        """Announce an upload; the body may have the first bytes of the file, or all of them."""
        client = await self._client(request)
        tus.check_version(request.headers)
        metadata = tus.metadata(request.headers.get("Upload-Metadata", ""))
        name = metadata.get("filename", request.query.get("filename", ""))
        with_body = request.content_type == tus.CHUNK_TYPE
        given = request.headers.get("Upload-Length") or (request.headers.get("Content-Length") if with_body else None)
        length, mark = tus.number(given, "Upload-Length"), metadata.get("fingerprint", "")
        upload = self._uploads.create(client.user, name, length, mark)
        if with_body and request.can_read_body:
            upload = await self._uploads.append(client.user, upload.id, 0, _pieces(request))
        return _upload_answer(upload, 201, {"Location": f"{request.url.origin()}{PREFIX}/uploads/{upload.id}"})

    async def list_uploads(self, request: web.Request) -> web.Response:
        """List the uploads of the client."""
        client = await self._client(request)
        return _json(self._uploads.of(client.user))

    async def show_upload(self, request: web.Request) -> web.Response:
        """Answer with an upload, as JSON and as headers."""
        client = await self._client(request)
        return _upload_answer(self._uploads.get(client.user, request.match_info["upload"]), 200)

    async def continue_upload(self, request: web.Request) -> web.Response:
        """Append data at the end of a file."""
        client = await self._client(request)
        tus.check_version(request.headers)
        tus.check_chunk(request.content_type)
        offset = tus.number(request.headers.get("Upload-Offset"), "Upload-Offset")
        upload = await self._uploads.append(client.user, request.match_info["upload"], offset, _pieces(request))
        return _upload_answer(upload, 204)

    async def remove_upload(self, request: web.Request) -> web.Response:
        """Remove an upload that no job needs."""
        client = await self._client(request)
        upload = request.match_info["upload"]
        self._uploads.get(client.user, upload)
        if self._jobs.uses(upload):
            raise InvalidRequest(f"a job needs upload {upload}: wait until it is over, or cancel it", field="upload")
        await self._uploads.remove(client.user, upload)
        return web.Response(status=204, headers=tus.answer_headers())

    # --- jobs --------------------------------------------------------------------------------------------------------

    async def submit(self, request: web.Request) -> web.Response:
        """Inspect the recording and queue a job."""
        client = await self._client(request)
        wanted = decode(await _body(request), JobRequest)
        job = await self._jobs.submit(client.user, client.secret, wanted)
        return _json(job, 201, {"Location": f"{request.url.origin()}{PREFIX}/jobs/{job.id}"})

    async def list_jobs(self, request: web.Request) -> web.Response:
        """List the jobs of the client, the newest first."""
        client = await self._client(request)
        return _json(self._jobs.of(client.user))

    async def show_job(self, request: web.Request) -> web.Response:
        """Answer with a job."""
        client = await self._client(request)
        return _json(self._jobs.get(client.user, request.match_info["job"]))

    async def cancel(self, request: web.Request) -> web.Response:
        """Cancel a job; one that is over does not change."""
        client = await self._client(request)
        return _json(self._jobs.cancel(client.user, request.match_info["job"]))

    async def remove_job(self, request: web.Request) -> web.Response:
        """Remove a job that is over, with its files."""
        client = await self._client(request)
        await self._jobs.remove(client.user, request.match_info["job"])
        return web.Response(status=204)

    async def plan(self, request: web.Request) -> web.Response:
        """Plan a path on the map of a job."""
        client = await self._client(request)
        wanted = decode(await _body(request), PlanRequest)
        return _json(await self._plans.plan(client.user, request.match_info["job"], wanted))

    async def events(self, request: web.Request) -> web.StreamResponse:
        """Stream the job, now and after each change until it is over, as server-sent events named `job`."""
        client = await self._client(request)
        job = request.match_info["job"]
        self._jobs.get(client.user, job)
        headers = {"Content-Type": "text/event-stream", "Cache-Control": "no-store", "X-Accel-Buffering": "no"}
        stream = web.StreamResponse(headers=headers)
        await stream.prepare(request)
        changes = self._jobs.watch(client.user, job)
        coming = asyncio.ensure_future(anext(changes))
        try:
            while True:
                invalidation = self._authenticator.invalidation(client.user)
                ends: set[asyncio.Future[Any]] = {coming, invalidation}
                await asyncio.wait(ends, timeout=HEARTBEAT, return_when=asyncio.FIRST_COMPLETED)
                if invalidation.done():
                    await self._client(request)
                if not coming.done():
                    await stream.write(b": still here\n\n")
                    continue
                await stream.write(b"event: job\ndata: " + msgspec.json.encode(coming.result()) + b"\n\n")
                coming = asyncio.ensure_future(anext(changes))
        except StopAsyncIteration:
            with contextlib.suppress(ConnectionError):  # the client may have disconnected after the last event
                await stream.write_eof()
        except ConnectionError:
            pass  # the client has disconnected
        except (Unauthorized, Forbidden, NotFound) as error:  # NotFound: the job was removed before its end was sent
            log.info("event stream closed: {error}", error=str(error))
        finally:
            coming.cancel()
        return stream

    async def file(self, request: web.Request) -> web.StreamResponse:
        """Send a result file."""
        client = await self._client(request)
        path = self._jobs.file(client.user, request.match_info["job"], request.match_info["file"])
        kind = TYPES.get(path.suffix, "text/plain; charset=utf-8")
        return web.FileResponse(path, headers={"Content-Type": kind})


async def _body(request: web.Request) -> bytes:
    """Return a body of JSON.

    Raises:
        HttpError: It is too large.
    """
    body = await read_accepted_body(request)
    if len(body) > MAX_REQUEST:
        raise HttpError(f"the request has more than {MAX_REQUEST} bytes", status=TOO_LARGE)
    return body


def _json(value: object, status: int = 200, headers: dict[str, str] | None = None) -> web.Response:
    body = msgspec.json.encode(value)
    return web.Response(status=status, body=body, content_type="application/json", headers=headers)


def _upload_answer(upload: Upload, status: int, headers: dict[str, str] | None = None) -> web.Response:
    given = {
        "Upload-Offset": str(upload.offset),
        "Upload-Length": str(upload.length),
        "Upload-Expires": formatdate(upload.expires, usegmt=True),
        "Cache-Control": "no-store",
    }
    answer = web.Response(status=status, headers=tus.answer_headers(given | (headers or {})))
    if status != 204:
        answer.content_type = "application/json"
        answer.body = msgspec.json.encode(upload)
    return answer


async def _pieces(request: web.Request) -> AsyncIterator[bytes]:
    """Yield the body as it comes; end normally if the client disconnects, so that the received part is kept."""
    try:
        async for piece in body_pieces(request):
            yield piece
    except web.HTTPRequestTimeout:
        raise TimedOut("the data came too slowly: continue at the offset that HEAD returns") from None
    except ConnectionError:
        return
