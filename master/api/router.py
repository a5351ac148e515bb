"""Routing of API requests to their handlers, with authentication, audit, idempotency and errors as problem+json."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qs, unquote

import msgspec
from aiohttp import web
from msgspec import Struct
from twisted.logger import Logger

from master.access.audit import Audit
from master.access.users import Users
from master.api.authentication import Authenticator, authorization
from master.api.downloads import Download
from master.api.idempotency import IdempotencyCache
from master.api.request import Answer, AuditDetails, Call, Handler
from master.api.streams import EventStream
from master.storage.depot import Upload
from rce.errors import InternalError, InvalidRequest, NotFound, RceError, disk_full
from rce.process import logs
from rce.web.problems import MethodNotAllowed, UnsupportedMediaType, problem_response
from rce.web.requests import check_same_site, header, raw_path, raw_query

PREFIX = "/api/v1"
JSON = "application/json"
READ_METHODS = ("GET", "HEAD")
RawHandler = Callable[[web.BaseRequest], Awaitable[web.StreamResponse]]
log = Logger()


class Route(NamedTuple):
    """A method of a path, its handler, and all that the OpenAPI document says about it.

    `query`, `body` and `answer` are types. A `public` route takes no credentials, or tickets in their place. Of a
    `streamed` one the handler reads the body itself, as it comes.
    """

    method: str
    path: str
    handler: Handler
    summary: str = ""
    query: type[Struct] | None = None
    body: Any = None
    answer: Any = None
    status: int = 200
    public: bool = False
    streamed: bool = False

    def pattern(self, prefix: str) -> re.Pattern[str]:
        """Return what matches the paths of this route."""
        return re.compile(re.sub(r"\\\{(\w+)\\\}", r"(?P<\1>[^/]+)", re.escape(prefix + self.path)))


class Api:
    """Routes below PREFIX, and some beside it."""

    def __init__(self, users: Users, audit: Audit, removals: Callable[[], Mapping[str, float]] = dict) -> None:
        self.routes: list[Route] = []
        self.on_stop: list[Callable[[], Awaitable[None]]] = []
        self._authenticator = Authenticator(users, audit)
        self._idempotency = IdempotencyCache(removals)
        self._patterns: list[tuple[re.Pattern[str], Route]] = []
        self._mounted: dict[str, RawHandler] = {}

    def add(self, *routes: Route) -> None:
        """Add routes below PREFIX; `{word}` in a path stands for any one segment."""
        self.routes += routes
        self._patterns += [(route.pattern(PREFIX), route) for route in routes]

    def add_outside_prefix(self, *routes: Route) -> None:
        """Add routes with complete paths, which are not part of the API's description."""
        self._patterns += [(route.pattern(""), route) for route in routes]

    def mount(self, path: str, handler: RawHandler) -> None:
        """Give all requests for a path below PREFIX to a handler that authenticates them itself."""
        self._mounted[PREFIX + path] = handler

    def streams(self, request: web.BaseRequest) -> bool:
        """Return whether the handler of a request reads its body itself."""
        path, method = raw_path(request), request.method
        return any(
            route.streamed and route.method == method and pattern.fullmatch(path) for pattern, route in self._patterns
        )

    async def stop(self) -> None:
        """End the answers that would go on for ever: the server stops."""
        await asyncio.gather(*(stop() for stop in self.on_stop))

    async def handle(self, request: web.BaseRequest, content: bytes, upload: Upload | None) -> web.StreamResponse:
        """Answer a request whose body has been received, unless its route is streamed."""
        mounted = self._mounted.get(raw_path(request))
        if mounted is not None:
            return await mounted(request)
        headers = {"X-Request-Id": logs.set_request_id(header(request, "X-Request-Id") or "")}
        status = 499  # the client disconnected before there was an answer
        try:
            response = await self._respond(request, content, upload, headers)
            status = response.status
            return response
        finally:
            if request.method not in READ_METHODS:
                path = raw_path(request)[:500]
                log.info("{method} {path}: {status}", method=request.method[:20], path=path, status=status)

    async def _respond(
        self, request: web.BaseRequest, content: bytes, upload: Upload | None, headers: dict[str, str]
    ) -> web.StreamResponse:
        try:
            return await self._send(request, await self._answer(request, content, upload), headers)
        except RceError as error:
            response = problem_response(error)
        except ConnectionError:
            raise  # the client disconnected
        except Exception as error:  # noqa: BLE001  # the client is told of the defect; the traceback goes to the log
            full = disk_full(error) if isinstance(error, OSError) else None
            if full is None:
                log.failure("defect while answering {method} {path}", method=request.method, path=raw_path(request))
            response = problem_response(full or InternalError("internal error; the Master's log has the traceback"))
        response.headers.update(headers)
        return response

    async def _send(self, request: web.BaseRequest, answer: Answer, headers: dict[str, str]) -> web.StreamResponse:
        status, headers = answer.status, headers | answer.headers
        match answer.body:
            case EventStream() | Download() as stream:
                return await stream.send(request, headers)
            case Path() as path:
                return web.FileResponse(path, headers=headers | {"Content-Type": "application/octet-stream"})
            case bytes() as text:
                return web.Response(status=status, body=text, headers=headers)
            case None:
                return web.Response(status=status, headers=headers)
            case body:
                content = msgspec.json.encode(body)
                return web.Response(status=status, body=content, content_type=JSON, headers=headers)

    async def _answer(self, request: web.BaseRequest, content: bytes, upload: Upload | None) -> Answer:
        check_same_site(request)
        route, variables = self._find(request)
        principal = None if route.public else await self._authenticator.authenticate(request)
        if route.body is not None:
            _check_media_type(request)
        user = principal.user if principal else ""
        _, token = authorization(request)
        parameters = _parameters(request)
        call = Call(user, principal, variables, token, content, upload, parameters, request, AuditDetails())

        async def handler(call: Call) -> Answer:
            return await self._authenticator.audited(call, route.handler)

        return await (self._idempotency.answer(call, handler) if route.method == "POST" else handler(call))

    def _find(self, request: web.BaseRequest) -> tuple[Route, dict[str, str]]:
        """Return the route of a request and the variables in its path; paths without variables take precedence."""
        path, method = raw_path(request), request.method
        found = [(route, match) for pattern, route in self._patterns if (match := pattern.fullmatch(path))]
        if not found:
            raise NotFound(f"there is nothing at {path[:200]}")
        exact = [(route, match) for route, match in found if not match.groups()]
        by_method = {route.method: (route, match) for route, match in exact or found}
        chosen = by_method.get("GET" if method == "HEAD" else method)
        if chosen is None:
            allowed = ", ".join(sorted([*by_method, *(["HEAD"] if "GET" in by_method else [])]))
            message = f"{path[:200]} takes {allowed}, not {method[:20]}"
            raise MethodNotAllowed(message, headers={"Allow": allowed})
        route, match = chosen
        return route, {name: _unquoted(segment, path) for name, segment in match.groupdict().items()}


def _unquoted(segment: str, path: str) -> str:
    try:
        return unquote(segment, errors="strict")
    except UnicodeDecodeError:
        raise NotFound(f"there is nothing at {path[:200]}") from None


def _parameters(request: web.BaseRequest) -> dict[str, str]:
    """Return the parameters of the query; a form in the body has none.

    Raises:
        InvalidRequest: The query is not percent-encoded UTF-8, or a parameter is given several times.
    """
    query = raw_query(request)
    try:
        found = parse_qs(query.encode("ascii").decode(), keep_blank_values=True, errors="strict")
    except ValueError:
        raise InvalidRequest("query: it is not percent-encoded UTF-8", field="query") from None
    for name, values in found.items():
        if len(values) > 1:
            raise InvalidRequest(f"query.{name[:80]}: given {len(values)} times", field=name[:80])
    return {name: values[0] for name, values in found.items()}


def _check_media_type(request: web.BaseRequest) -> None:
    """Refuse bodies without a type and forms, which a page of another site can have a browser send; JSON it cannot."""
    kind = (header(request, "Content-Type") or "").partition(";")[0].strip().lower()
    if kind != JSON:
        raise UnsupportedMediaType(f"the body must have Content-Type: {JSON}, not {kind[:80] or 'none'}")
