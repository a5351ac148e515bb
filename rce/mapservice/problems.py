"""Errors as answers: `application/problem+json` (RFC 9457) with the code, the field and the particulars."""

from __future__ import annotations

from http import HTTPStatus
from typing import Any, TypeVar

import msgspec
from aiohttp import web
from aiohttp.typedefs import Handler
from twisted.logger import Logger

from rce.errors import InternalError, InvalidRequest, NotFound, RceError
from rce.map_jobs import Problem
from rce.mapservice.files import DiskFull
from rce.metrics import errors

TYPE = "application/problem+json"
STATUS = {
    "invalid_request": 400,
    "invalid_name": 400,
    "offset_mismatch": 409,
    "unauthorized": 401,
    "too_many_attempts": 429,
    "forbidden": 403,
    "not_found": 404,
    "already_exists": 409,
    "limit_exceeded": 429,
    "no_capacity": 503,
    "unavailable": 503,
    "lost": 503,
    "timed_out": 504,
}
WRONG_TYPE, WRONG_VERSION, TOO_LARGE = 415, 412, 413

T = TypeVar("T")
log = Logger()


class Refused(InvalidRequest):
    """A request that is refused with an HTTP status of its own."""

    def __init__(self, status: int, message: str, field: str = "") -> None:
        super().__init__(message, field=field)
        self.status = status


def status_of(error: RceError) -> int:
    if isinstance(error, Refused):
        return error.status
    if error.info.code == "limit_exceeded" and "asked" in error.info.fields:  # a size, not a number of requests
        return TOO_LARGE
    return STATUS.get(error.info.code, 500)


def answer(error: RceError) -> web.Response:
    status, info = status_of(error), error.info
    errors.add("http", info.code)
    problem = Problem(HTTPStatus(status).phrase, status, info.message, info.code, info.field, info.fields)
    headers = {"WWW-Authenticate": 'Bearer, Basic realm="rce"'} if status == 401 else {}
    return web.Response(status=status, body=msgspec.json.encode(problem), content_type=TYPE, headers=headers)


@web.middleware
async def problems(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Whatever goes wrong is answered in one form."""
    try:
        check_headers(request)
        return await handler(request)
    except RceError as error:
        return answer(error)
    except web.HTTPNotFound:
        return answer(NotFound(f"there is nothing at {request.path}"))
    except web.HTTPException as error:
        return answer(Refused(error.status, error.text or error.reason))
    except ConnectionError:
        raise  # nobody is there to hear it
    except Exception as error:  # noqa: BLE001  # the client hears of a defect; the traceback stays in the log
        return answer(unexpected(error, f"{request.method} {request.path}"))


def check_headers(request: web.Request) -> None:
    """InvalidRequest for those that cannot be read: aiohttp keeps them as they are, and fails where they are used."""
    try:
        request.url.origin()
        for value in request.headers.values():
            value.encode()
    except ValueError:  # of which what is raised for no UTF-8 is one
        raise InvalidRequest("headers must be in UTF-8, and Host must name a host", field="Host") from None


def unexpected(error: Exception, where: str) -> RceError:
    """What the client hears of an error that nobody raised on purpose; called where that is handled."""
    full = DiskFull.of(error)
    if full is not None:
        log.error("{where}: {error}", where=where, error=str(error))
        return full
    log.failure("defect at {where}", where=where)
    return InternalError("a defect of the map service; its log has the traceback")


def decode(body: bytes, kind: type[T], *, strict: bool = True) -> T:
    """InvalidRequest with the path of the field at fault (`options.resolution`)."""
    try:
        return msgspec.json.decode(body, type=kind, strict=strict)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _invalid(error) from None


def convert(value: Any, kind: type[T]) -> T:
    """The same for what came as text in another form. InvalidRequest."""
    try:
        return msgspec.convert(value, kind, strict=False)
    except msgspec.ValidationError as error:
        raise _invalid(error) from None


def _invalid(error: Exception) -> InvalidRequest:
    reason, _, path = str(error).partition(" - at `$")
    path = path.rstrip("`").lstrip(".")
    return InvalidRequest(f"{path}: {reason}" if path else reason, field=path)
