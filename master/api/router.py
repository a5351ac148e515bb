"""Which function answers a request, who asks it, and how an answer or an error goes out."""

from __future__ import annotations

import asyncio
import base64
import binascii
import os
import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec
from msgspec import Struct
from twisted.logger import Logger
from twisted.protocols.basic import FileSender
from twisted.web.resource import Resource
from twisted.web.server import NOT_DONE_YET, Request

from master.grants import digest
from master.rights import Principal
from master.users import KEY_PREFIX, Users
from rce.errors import InternalError, InvalidRequest, NotFound, RceError, Unauthorized
from rce.http import PROBLEM, Problem

PREFIX = "/api/v1"
HASH = re.compile(r"[0-9a-f]{64}", re.ASCII)
STATUS = {
    "unauthorized": 401,
    "forbidden": 403,
    "not_found": 404,
    "method_not_allowed": 405,
    "already_exists": 409,
    "not_connectable": 409,
    "limit_exceeded": 413,
    "no_capacity": 503,
    "unavailable": 503,
    "lost": 503,
    "timed_out": 504,
    "internal": 500,
    "error": 500,
}
"""Status codes by those of errors; every other error is the asker's (400)."""

log = Logger()
T = TypeVar("T")


class MethodNotAllowed(InvalidRequest):
    """The resource is there, and cannot be asked that."""

    code = "method_not_allowed"


class Call(NamedTuple):
    """A request, as its handler sees it. `content` is the file-like body; without `principal` a token says it all."""

    user: str
    principal: Principal | None
    path: dict[str, str]
    token: str
    content: Any

    def body(self, kind: type[T]) -> T:
        """The JSON body. InvalidRequest."""
        try:
            return msgspec.json.decode(self.content.read(), type=kind)
        except msgspec.DecodeError as error:
            raise InvalidRequest(f"body: {error}", field="body") from None


class Answer(NamedTuple):
    """`body` goes out as JSON, a path as the file there, None not at all."""

    body: Struct | list[Any] | Path | None = None
    status: int = 200


Handler = Callable[[Call], Awaitable[Answer]]


class _Route(NamedTuple):
    pattern: re.Pattern[str]
    method: str
    handler: Handler
    for_all: bool


class Api(Resource):
    """Answers what routes were added for, below PREFIX."""

    isLeaf = True

    def __init__(self, users: Users) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # Twisted's
        self._users = users
        self._routes: list[_Route] = []
        self._tasks: set[asyncio.Task[None]] = set()

    def add(self, method: str, path: str, handler: Handler, *, for_all: bool = False) -> None:
        """`{word}` in the path stands for any one part. `for_all`: who asks is not asked for; tickets say it."""
        pattern = re.sub(r"\\\{(\w+)\\\}", r"(?P<\1>[^/]+)", re.escape(PREFIX + path))
        self._routes.append(_Route(re.compile(pattern), method, handler, for_all))

    def render(self, request: Request) -> int:
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
        try:
            answer = await self._answer(request)
        except RceError as error:
            return _refuse(request, error)
        except Exception:  # noqa: BLE001  # the asker must hear of a defect; the traceback is in the log
            log.failure("defect while answering {method} {path}", method=request.method, path=request.path)
            return _refuse(request, InternalError("a defect while answering; see the Master's log"))
        request.setResponseCode(answer.status)
        match answer.body:
            case Path() as path:
                await _send(request, path)
            case None:
                request.finish()
            case body:
                _write(request, msgspec.json.encode(body), "application/json")

    async def _answer(self, request: Request) -> Answer:
        path = request.path.decode("ascii", "replace")
        matches = [(route, match) for route in self._routes if (match := route.pattern.fullmatch(path))]
        if not matches:
            raise NotFound(f"there is nothing at {path[:200]}")
        method = request.method.decode("ascii", "replace")
        for route, match in matches:
            if route.method == method:
                kind, credentials = authorization(request)
                principal = None if route.for_all else await self._authenticate(kind, credentials)
                user = principal.user if principal else ""
                return await route.handler(Call(user, principal, match.groupdict(), credentials, request.content))
        allowed = ", ".join(sorted(route.method for route, _ in matches))
        raise MethodNotAllowed(f"{path[:200]} takes {allowed}, not {method[:20]}")

    async def _authenticate(self, kind: str, credentials: str) -> Principal:
        """An API key as bearer, or `user:secret` as basic. The secret is a key, a password, or its SHA-256 in hex, as
        robots send it: a password that looks like one must be hashed by who sends it.
        """
        if kind == "bearer" and credentials.startswith(KEY_PREFIX):
            return await self._users.check("", credentials)
        if kind == "basic":
            try:
                user, colon, secret = base64.b64decode(credentials, validate=True).decode().partition(":")
            except (binascii.Error, UnicodeDecodeError):
                colon = ""
            if colon:
                plain = not (secret.startswith(KEY_PREFIX) or HASH.fullmatch(secret))
                return await self._users.check(user, digest(secret) if plain else secret)
        raise Unauthorized("say who you are: Authorization: Bearer API-KEY, or Basic with user and password or key")


def authorization(request: Request) -> tuple[str, str]:
    """The kind of the credentials, in lower case, and the credentials."""
    kind, _, credentials = (request.getHeader("authorization") or "").partition(" ")
    return kind.lower(), credentials.strip()


def _refuse(request: Request, error: RceError) -> None:
    info = error.info
    status = STATUS.get(info.code, 400)
    title = info.code.replace("_", " ").capitalize()
    problem = Problem(title, status, info.message, info.code, info.field, info.fields)
    request.setResponseCode(status)
    if status == 401:
        request.setHeader("www-authenticate", 'Basic realm="rce"')
    _write(request, msgspec.json.encode(problem), PROBLEM)


async def _send(request: Request, path: Path) -> None:
    """A file, as fast as it is taken; ends with an exception when the other side goes away."""
    with path.open("rb") as file:
        request.setHeader("content-type", "application/octet-stream")
        request.setHeader("content-length", str(os.fstat(file.fileno()).st_size))
        await FileSender().beginFileTransfer(file, request).asFuture(asyncio.get_running_loop())
    request.finish()


def _write(request: Request, body: bytes, kind: str) -> None:
    request.setHeader("content-type", kind)
    request.setHeader("content-length", str(len(body)))
    request.write(body)
    request.finish()
