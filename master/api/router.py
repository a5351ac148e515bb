"""Which function answers a request, who asks it, and how an answer or an error goes out."""

from __future__ import annotations

import asyncio
import os
import re
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qs, unquote

import msgspec
from msgspec import Struct
from twisted.logger import Logger
from twisted.protocols.basic import FileSender
from twisted.web.resource import Resource
from twisted.web.server import NOT_DONE_YET, Request

from master.api.calls import Answer, Call, Handler, Trail
from master.api.door import Door, authorization
from master.api.problems import MethodNotAllowed, UnsupportedMediaType, refuse, write
from master.api.repeats import Repeats
from master.api.streams import Stream
from master.audit import Audit
from master.users import Users
from rce import logs
from rce.errors import InternalError, InvalidRequest, NotFound, RceError

PREFIX = "/api/v1"
JSON = "application/json"
READS = (b"GET", b"HEAD")
log = Logger()


class Route(NamedTuple):
    """What one method does at one path, with all that its description needs.

    `query`, `body` and `answer` are types; `for_all`: who asks is not asked for, tickets say it.
    """

    method: str
    path: str
    handler: Handler
    summary: str = ""
    query: type[Struct] | None = None
    body: Any = None
    answer: Any = None
    status: int = 200
    for_all: bool = False

    def pattern(self, prefix: str) -> re.Pattern[str]:
        return re.compile(re.sub(r"\\\{(\w+)\\\}", r"(?P<\1>[^/]+)", re.escape(prefix + self.path)))


class Api(Resource):
    """Answers what routes were added for, below PREFIX."""

    isLeaf = True

    def __init__(self, users: Users, audit: Audit) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # Twisted's
        self._door = Door(users, audit)
        self._repeats = Repeats()
        self.routes: list[Route] = []
        self._patterns: list[tuple[re.Pattern[str], Route]] = []
        self._mounted: dict[bytes, Resource] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def add(self, *routes: Route) -> None:
        """`{word}` in a path stands for any one part."""
        self.routes += routes
        self._patterns += [(route.pattern(PREFIX), route) for route in routes]

    def add_beside(self, *routes: Route) -> None:
        """The same for paths of their own, which are no part of the API and its description."""
        self._patterns += [(route.pattern(""), route) for route in routes]

    def mount(self, path: str, resource: Resource) -> None:
        """Let a resource answer at this path by itself."""
        self._mounted[(PREFIX + path).encode()] = resource

    def render(self, request: Request) -> Any:
        if request.path in self._mounted:
            return self._mounted[request.path].render(request)
        task = asyncio.ensure_future(self._serve(request))
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        request.notifyFinish().addErrback(lambda _: task.cancel())
        return NOT_DONE_YET

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            log.info("an answer did not reach who asked: {error}", error=str(error))

    async def _serve(self, request: Request) -> None:
        request.setHeader("x-request-id", logs.enter(request.getHeader("x-request-id") or ""))
        try:
            await self._respond(request)
        finally:
            if request.method not in READS:
                method, path = request.method.decode("ascii", "replace"), request.path.decode("ascii", "replace")
                log.info("{method} {path}: {status}", method=method[:20], path=path[:500], status=request.code)

    async def _respond(self, request: Request) -> None:
        try:
            answer = await self._answer(request)
        except RceError as error:
            return refuse(request, error)
        except Exception:  # noqa: BLE001  # the asker must hear of a defect; the traceback is in the log
            log.failure("defect while answering {method} {path}", method=request.method, path=request.path)
            return refuse(request, InternalError("a defect while answering; see the Master's log"))
        request.setResponseCode(answer.status)
        for name, value in answer.headers.items():
            request.setHeader(name, value)
        match answer.body:
            case Path() as path:
                await _send(request, path)
            case Stream() as stream:
                await stream.run(request)
            case bytes() as text:
                write(request, text, answer.headers["content-type"])
            case None:
                request.finish()
            case body:
                write(request, msgspec.json.encode(body), JSON)

    async def _answer(self, request: Request) -> Answer:
        path = request.path.decode("ascii", "replace")
        found_here = [(route, match) for pattern, route in self._patterns if (match := pattern.fullmatch(path))]
        if not found_here:
            raise NotFound(f"there is nothing at {path[:200]}")
        exact = [(route, match) for route, match in found_here if not match.groups()]
        matches = {route.method: (route, match) for route, match in exact or found_here}
        method = request.method.decode("ascii", "replace")
        found = matches.get("GET" if method == "HEAD" else method)
        if found is None:
            allowed = ", ".join(sorted([*matches, *(["HEAD"] if "GET" in matches else [])]))
            request.setHeader("allow", allowed)
            raise MethodNotAllowed(f"{path[:200]} takes {allowed}, not {method[:20]}")
        route, match = found
        principal = None if route.for_all else await self._door.enter(request)
        if route.body is not None:
            _check_kind(request)
        parts = {name: _unquoted(part, path) for name, part in match.groupdict().items()}
        user = principal.user if principal else ""
        _, token = authorization(request)
        made = Call(user, principal, parts, token, request.content, _query(request), request, Trail())

        async def handler(call: Call) -> Answer:
            return await self._door.audited(call, route.handler)

        return await (self._repeats.answer(made, handler) if method == "POST" else handler(made))


def _unquoted(part: str, path: str) -> str:
    try:
        return unquote(part, errors="strict")
    except UnicodeDecodeError:
        raise NotFound(f"there is nothing at {path[:200]}") from None


def _query(request: Request) -> dict[str, str]:
    """Each parameter of the address once; a form in the body is none."""
    try:
        words = parse_qs(request.uri.partition(b"?")[2].decode("ascii"), keep_blank_values=True, errors="strict")
    except ValueError:
        raise InvalidRequest("query: it is not percent-encoded UTF-8", field="query") from None
    for name, values in words.items():
        if len(values) > 1:
            raise InvalidRequest(f"query.{name[:80]}: given {len(values)} times", field=name[:80])
    return {name: values[0] for name, values in words.items()}


def _check_kind(request: Request) -> None:
    """A browser that knows a user's password sends forms for whoever asks it to; JSON it does not."""
    kind = (request.getHeader("content-type") or JSON).partition(";")[0].strip().lower()
    if kind != JSON:
        raise UnsupportedMediaType(f"the body must be {JSON}, not {kind[:80]}")


async def _send(request: Request, path: Path) -> None:
    """A file, as fast as it is taken; ends with an exception when the other side goes away."""
    with path.open("rb") as file:
        request.setHeader("content-type", "application/octet-stream")
        request.setHeader("content-length", str(os.fstat(file.fileno()).st_size))
        await FileSender().beginFileTransfer(file, request).asFuture(asyncio.get_running_loop())
    request.finish()
