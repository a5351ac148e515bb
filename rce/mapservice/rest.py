"""The REST interface: uploads (tus 1.0), jobs, their progress and their files."""

from __future__ import annotations

import asyncio
import base64
import contextlib
from collections.abc import AsyncIterator
from email.utils import formatdate
from typing import Any

import msgspec
from aiohttp import ClientError, web
from twisted.logger import Logger

from rce.errors import Forbidden, InvalidRequest, TimedOut, Unauthorized
from rce.map_jobs import PREFIX, JobRequest, Upload
from rce.mapservice.access import Access, Client
from rce.mapservice.jobs import Jobs
from rce.mapservice.noting import CLIENT
from rce.mapservice.problems import TOO_LARGE, WRONG_TYPE, WRONG_VERSION, Refused, decode
from rce.mapservice.uploads import Uploads

TUS = "1.0.0"
EXTENSIONS = "creation,creation-with-upload,expiration,termination"
PIECE_TYPE = "application/offset+octet-stream"
REQUEST_MOST = 64 * 1024  # bytes of a JSON body
IDLE = 60.0  # seconds after which an upload from which nothing comes is broken off
HEARTBEAT = 15.0  # seconds after which a stream of events that has none says so
TYPES = {
    ".pgm": "image/x-portable-graymap",
    ".png": "image/png",
    ".yaml": "application/yaml",
    ".json": "application/json",
}
log = Logger()


class Rest:
    """The handlers. Each first learns who the client is."""

    def __init__(self, access: Access, uploads: Uploads, jobs: Jobs) -> None:
        self._access, self._uploads, self._jobs = access, uploads, jobs

    async def _client(self, request: web.Request) -> Client:
        operation = "job.read" if request.method in ("GET", "HEAD") else "job.submit"
        client = await self._access.client(request.headers, request.query, operation, request.remote or "")
        request[CLIENT] = client
        return client

    async def asked(self, request: web.Request) -> None:
        """Raises what is wrong with a request whose body has not been sent yet."""
        await self._client(request)
        upload = request.match_info.get("upload")
        if upload is not None and request.method == "PATCH":
            await self.show_upload(request)

    # --- uploads -----------------------------------------------------------------------------------------------------

    async def abilities(self, request: web.Request) -> web.Response:
        """What of tus is spoken here."""
        headers = {"Tus-Version": TUS, "Tus-Extension": EXTENSIONS, "Tus-Max-Size": str(self._uploads.largest)}
        return web.Response(status=204, headers=_tus(headers))

    async def create_upload(self, request: web.Request) -> web.Response:
        """Announce a file; with a body, its first bytes or all of them come along."""
        client = await self._client(request)
        _check_version(request)
        metadata = _metadata(request.headers.get("Upload-Metadata", ""))
        name = metadata.get("filename", request.query.get("filename", ""))
        with_body = request.content_type == PIECE_TYPE
        given = request.headers.get("Upload-Length") or (request.headers.get("Content-Length") if with_body else None)
        length, mark = _number(given, "Upload-Length"), metadata.get("fingerprint", "")
        upload = self._uploads.create(client.user, name, length, mark)
        if with_body and request.can_read_body:
            upload = await self._uploads.append(client.user, upload.id, 0, _pieces(request))
        return _upload_answer(upload, 201, {"Location": f"{request.url.origin()}{PREFIX}/uploads/{upload.id}"})

    async def list_uploads(self, request: web.Request) -> web.Response:
        client = await self._client(request)
        return _json(self._uploads.of(client.user))

    async def show_upload(self, request: web.Request) -> web.Response:
        """As JSON for GET, as headers for HEAD."""
        client = await self._client(request)
        return _upload_answer(self._uploads.get(client.user, request.match_info["upload"]), 200)

    async def continue_upload(self, request: web.Request) -> web.Response:
        """Add bytes at the offset at which the file ends so far."""
        client = await self._client(request)
        _check_version(request)
        if request.content_type != PIECE_TYPE:
            raise Refused(WRONG_TYPE, f"the Content-Type must be {PIECE_TYPE}", "Content-Type")
        offset = _number(request.headers.get("Upload-Offset"), "Upload-Offset")
        upload = await self._uploads.append(client.user, request.match_info["upload"], offset, _pieces(request))
        return _upload_answer(upload, 204)

    async def remove_upload(self, request: web.Request) -> web.Response:
        client = await self._client(request)
        upload = request.match_info["upload"]
        self._uploads.get(client.user, upload)
        if self._jobs.uses(upload):
            raise InvalidRequest(f"a job needs upload {upload}: wait for its end, or cancel it", field="upload")
        await self._uploads.remove(client.user, upload)
        return web.Response(status=204, headers=_tus())

    # --- jobs --------------------------------------------------------------------------------------------------------

    async def submit(self, request: web.Request) -> web.Response:
        """Look at the recording and queue the job."""
        client = await self._client(request)
        body = await request.read()
        if len(body) > REQUEST_MOST:
            raise Refused(TOO_LARGE, f"a request of more than {REQUEST_MOST} bytes is not one for a map")
        wanted = decode(body, JobRequest)
        job = await self._jobs.submit(client.user, client.secret, wanted)
        return _json(job, 201, {"Location": f"{request.url.origin()}{PREFIX}/jobs/{job.id}"})

    async def list_jobs(self, request: web.Request) -> web.Response:
        """The newest first."""
        client = await self._client(request)
        return _json(self._jobs.of(client.user))

    async def show_job(self, request: web.Request) -> web.Response:
        client = await self._client(request)
        return _json(self._jobs.get(client.user, request.match_info["job"]))

    async def cancel(self, request: web.Request) -> web.Response:
        """A job that is over stays as it is."""
        client = await self._client(request)
        return _json(self._jobs.cancel(client.user, request.match_info["job"]))

    async def remove_job(self, request: web.Request) -> web.Response:
        """Remove a job that is over, with its files."""
        client = await self._client(request)
        await self._jobs.remove(client.user, request.match_info["job"])
        return web.Response(status=204)

    async def events(self, request: web.Request) -> web.StreamResponse:
        """The job now and after each change, as server-sent events `job`, until it is over."""
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
                doubt = self._access.doubt(client.user)
                ends: set[asyncio.Future[Any]] = {coming, doubt}
                await asyncio.wait(ends, timeout=HEARTBEAT, return_when=asyncio.FIRST_COMPLETED)
                if doubt.done():
                    await self._client(request)
                if not coming.done():
                    await stream.write(b": still here\n\n")
                    continue
                await stream.write(b"event: job\ndata: " + msgspec.json.encode(coming.result()) + b"\n\n")
                coming = asyncio.ensure_future(anext(changes))
        except StopAsyncIteration:
            with contextlib.suppress(ConnectionError):  # who has heard the end may have left
                await stream.write_eof()
        except ConnectionError:
            pass  # nobody listens any more
        except (Unauthorized, Forbidden) as error:
            log.info("a stream of events ends: {error}", error=str(error))
        finally:
            coming.cancel()
        return stream

    async def file(self, request: web.Request) -> web.StreamResponse:
        client = await self._client(request)
        path = self._jobs.file(client.user, request.match_info["job"], request.match_info["file"])
        kind = TYPES.get(path.suffix, "text/plain; charset=utf-8")
        return web.FileResponse(path, headers={"Content-Type": kind})


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
    answer = web.Response(status=status, headers=_tus(given | (headers or {})))
    if status != 204:
        answer.content_type = "application/json"
        answer.body = msgspec.json.encode(upload)
    return answer


def _tus(headers: dict[str, str] | None = None) -> dict[str, str]:
    return {"Tus-Resumable": TUS, **(headers or {})}


def _check_version(request: web.Request) -> None:
    """A client that does not name tus, such as curl, is taken to know what it does."""
    if request.headers.get("Tus-Resumable", TUS) != TUS:
        raise Refused(WRONG_VERSION, f"tus {TUS} is spoken here", "Tus-Resumable")


def _number(text: str | None, field: str) -> int:
    if text is None or not text.isascii() or not text.isdigit() or len(text) > 18:
        raise InvalidRequest(f"the header {field} must be given, as a number of bytes", field=field)
    return int(text)


def _metadata(text: str) -> dict[str, str]:
    """`key base64,key base64` as tus has it. InvalidRequest."""
    found = {}
    for pair in filter(None, (part.strip() for part in text.split(","))):
        key, _, value = pair.partition(" ")
        try:
            found[key] = base64.b64decode(value, validate=True).decode()
        except ValueError:
            raise InvalidRequest(f"{key[:60]!r} is not followed by base64", field="Upload-Metadata") from None
    return found


async def _pieces(request: web.Request) -> AsyncIterator[bytes]:
    """The body as it comes. Ends where the client breaks off: what came until then is kept."""
    while True:
        try:
            async with asyncio.timeout(IDLE):
                piece = await request.content.readany()
        except TimeoutError:
            raise TimedOut(f"nothing came for {IDLE:g} s; continue at the offset that HEAD tells") from None
        except (ClientError, ConnectionError):
            return
        if not piece:
            return
        yield piece
