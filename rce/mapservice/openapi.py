"""What the REST interface offers, as one table: the routes are made from it, and so is the OpenAPI document."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import msgspec
from aiohttp import web
from aiohttp.typedefs import Handler

from rce import openapi
from rce.errors import RceError
from rce.map_jobs import PREFIX, Job, JobRequest, Upload
from rce.mapservice.problems import answer, check_headers
from rce.mapservice.rest import PIECE_TYPE, Rest

OFFSET, LENGTH, METADATA = "Upload-Offset", "Upload-Length", "Upload-Metadata"
HEADERS = {
    OFFSET: ("integer", "bytes that are there"),
    LENGTH: ("integer", "bytes of the whole file"),
    METADATA: ("string", "tus metadata: `filename` and, if the client likes, `fingerprint`, each followed by base64"),
}
PARAMETERS = {"upload": "id of an upload", "job": "id of a job", "file": "name of a result"}


class Route(NamedTuple):
    """`body` and `answer`: a type as JSON, or a media type; `headers` of the request, `told` of the answer."""

    method: str
    path: str
    handler: Handler
    summary: str
    status: int = 200
    body: Any = None
    answer: Any = None
    headers: tuple[str, ...] = ()
    told: tuple[str, ...] = ()
    open: bool = False


def routes(rest: Rest) -> list[Route]:
    sizes = (OFFSET, LENGTH)
    return [
        Route("OPTIONS", "/uploads", rest.abilities, "What of tus 1.0 is spoken here", 204, open=True),
        Route(
            *("POST", "/uploads", rest.create_upload, "Announce a file, or send a small one at once", 201),
            *(PIECE_TYPE, Upload, (LENGTH, METADATA), sizes),
        ),
        Route("GET", "/uploads", rest.list_uploads, "Your uploads", answer=list[Upload]),
        Route("HEAD", "/uploads/{upload}", rest.show_upload, "How much of a file is there", told=sizes),
        Route("GET", "/uploads/{upload}", rest.show_upload, "An upload", answer=Upload, told=sizes),
        Route(
            *("PATCH", "/uploads/{upload}", rest.continue_upload, "Add bytes where the file ends so far", 204),
            *(PIECE_TYPE, None, (OFFSET,), sizes),
        ),
        Route("DELETE", "/uploads/{upload}", rest.remove_upload, "Remove an upload that no job needs", 204),
        Route("POST", "/jobs", rest.submit, "Have a map made of uploads", 201, JobRequest, Job),
        Route("GET", "/jobs", rest.list_jobs, "Your jobs, the newest first", answer=list[Job]),
        Route("GET", "/jobs/{job}", rest.show_job, "A job", answer=Job),
        Route("POST", "/jobs/{job}/cancel", rest.cancel, "End a job that is not over", answer=Job),
        Route("DELETE", "/jobs/{job}", rest.remove_job, "Remove a job that is over, with its files", 204),
        Route(
            "GET",
            "/jobs/{job}/events",
            rest.events,
            "The job after each change, as events `job`",
            answer=openapi.EVENTS,
        ),
        Route("GET", "/jobs/{job}/files/{file}", rest.file, "A result", answer=openapi.BYTES),
    ]


def document(table: list[Route]) -> dict[str, Any]:
    """The OpenAPI 3.1 document."""
    query = {"type": "apiKey", "in": "query", "name": "key", "description": "an API key"}
    schemes = {"key": openapi.KEY, "password": openapi.PASSWORD, "query": query}
    description = (
        "Recordings in, maps out. Files are uploaded with tus 1.0 (https://tus.io); a job makes a "
        "map of them in an environment of its user. The same operations are offered in SOAP 1.1."
    )
    return openapi.document("RCE map service", description, map(_operation, table), schemes, schemes)


def _operation(route: Route) -> openapi.Operation:
    path = PREFIX + route.path
    given = (openapi.Parameter("header", name, HEADERS[name][1], {"type": HEADERS[name][0]}) for name in route.headers)
    return openapi.Operation(
        route.method,
        path,
        route.summary,
        route.status,
        route.body,
        route.method != "POST" or route.headers == (),
        () if route.answer is None else (route.answer,),
        (*openapi.path_parameters(path, PARAMETERS), *given),
        {name: HEADERS[name][0] for name in route.told},
        () if route.open else None,
    )


def add(application: web.Application, table: list[Route], asked: Callable[[web.Request], Awaitable[None]]) -> None:
    """The routes, and the document that describes them.

    `asked` raises why a client that asks first (`Expect: 100-continue`) need not send its body.
    """

    async def expect(request: web.Request) -> web.StreamResponse | None:
        try:
            check_headers(request)
            await asked(request)
        except RceError as error:
            return answer(error)
        if request.transport is not None:
            request.transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        return None

    text = msgspec.json.format(msgspec.json.encode(document(table)), indent=1)

    async def describe(_: web.Request) -> web.Response:
        return web.Response(body=text, content_type="application/json")

    for route in table:
        application.router.add_route(route.method, PREFIX + route.path, route.handler, expect_handler=expect)
    for path in ("", "/", "/openapi.json"):
        application.router.add_get(PREFIX + path, describe)
