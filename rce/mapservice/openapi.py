"""Operations of the REST interface in one table, from which the routes and the OpenAPI document are made."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

from aiohttp import web
from aiohttp.typedefs import Handler

from rce.api.map_jobs import PREFIX, Job, JobRequest, Plan, PlanRequest, Upload
from rce.errors import RceError
from rce.mapservice.rest import Rest
from rce.services.problems import check_headers
from rce.web import openapi, tus
from rce.web.problems import problem_response

OFFSET, LENGTH, METADATA = "Upload-Offset", "Upload-Length", "Upload-Metadata"
HEADERS = {
    OFFSET: ("integer", "bytes that have been received"),
    LENGTH: ("integer", "bytes of the whole file"),
    METADATA: ("string", "tus metadata: `filename` and optionally `fingerprint`, each followed by base64"),
}
PARAMETERS = {"upload": "id of an upload", "job": "id of a job", "file": "name of a result"}


class Route(NamedTuple):
    """A method of a path with its handler.

    `body` and `answer` are types, for JSON, or media types; `headers` are those of the request. A `public` route takes
    no credentials.
    """

    method: str
    path: str
    handler: Handler
    summary: str
    status: int = 200
    body: Any = None
    answer: Any = None
    headers: tuple[str, ...] = ()
    answer_headers: tuple[str, ...] = ()
    public: bool = False


def routes(rest: Rest) -> list[Route]:
    """Return the table."""
    sizes = (OFFSET, LENGTH)
    return [
        Route("OPTIONS", "/uploads", rest.tus_options, "Supported parts of tus 1.0", 204, public=True),
        Route(
            *("POST", "/uploads", rest.create_upload, "Announce a file, or send a small one at once", 201),
            *(tus.CHUNK_TYPE, Upload, (LENGTH, METADATA), sizes),
        ),
        Route("GET", "/uploads", rest.list_uploads, "Your uploads", answer=list[Upload]),
        Route("HEAD", "/uploads/{upload}", rest.show_upload, "Received length of an upload", answer_headers=sizes),
        Route("GET", "/uploads/{upload}", rest.show_upload, "An upload", answer=Upload, answer_headers=sizes),
        Route(
            *("PATCH", "/uploads/{upload}", rest.continue_upload, "Append bytes to an upload", 204),
            *(tus.CHUNK_TYPE, None, (OFFSET,), sizes),
        ),
        Route("DELETE", "/uploads/{upload}", rest.remove_upload, "Remove an upload that no job needs", 204),
        Route("POST", "/jobs", rest.submit, "Submit a job that makes a map of uploads", 201, JobRequest, Job),
        Route("GET", "/jobs", rest.list_jobs, "Your jobs, newest first", answer=list[Job]),
        Route("GET", "/jobs/{job}", rest.show_job, "A job", answer=Job),
        Route("POST", "/jobs/{job}/cancel", rest.cancel, "Cancel a job", answer=Job),
        Route("POST", "/jobs/{job}/plan", rest.plan, "Plan a path on the map of a job", 200, PlanRequest, Plan),
        Route("DELETE", "/jobs/{job}", rest.remove_job, "Remove a job that has ended, with its files", 204),
        Route(
            "GET",
            "/jobs/{job}/events",
            rest.events,
            "The job after each change, as server-sent events `job`",
            answer=openapi.EVENTS,
        ),
        Route("GET", "/jobs/{job}/files/{file}", rest.file, "A file of the result", answer=openapi.BYTES),
    ]


def document(table: list[Route]) -> dict[str, Any]:
    """Return the OpenAPI 3.1 document."""
    description = (
        "Recordings in, maps out. Files are uploaded with tus 1.0 (https://tus.io); a job makes a "
        "map of them in an environment of its user. The same operations are offered in SOAP 1.1."
    )
    return openapi.document("RCE map service", description, map(_operation, table), openapi.SCHEMES, openapi.SCHEMES)


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
        {name: HEADERS[name][0] for name in route.answer_headers},
        () if route.public else None,
    )


def add(application: web.Application, table: list[Route], check: Callable[[web.Request], Awaitable[None]]) -> None:
    """Add the routes, and the document that describes them.

    `check` refuses requests of clients that wait before they send the body (`Expect: 100-continue`).
    """

    async def expect(request: web.Request) -> web.StreamResponse | None:
        try:
            check_headers(request)
            await check(request)
        except RceError as error:
            return problem_response(error)
        if request.transport is not None:
            request.transport.write(b"HTTP/1.1 100 Continue\r\n\r\n")
        return None

    for route in table:
        application.router.add_route(route.method, PREFIX + route.path, route.handler, expect_handler=expect)
    openapi.serve(application, PREFIX, document(table))
