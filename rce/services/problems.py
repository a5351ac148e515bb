"""Errors of a service as problem+json, and decoding of what clients send."""

from __future__ import annotations

from typing import Any, TypeVar

import msgspec
from aiohttp import web
from aiohttp.typedefs import Handler
from twisted.logger import Logger

from rce.choices import with_choices
from rce.errors import InternalError, InvalidRequest, NotFound, RceError
from rce.services.auditing import FAILED
from rce.services.cors import by_key
from rce.services.disk import service_disk_full
from rce.value_count import check_value_count
from rce.web.problems import HttpError, problem_response
from rce.web.requests import check_encoding, check_same_site

TOO_LARGE = 413

T = TypeVar("T")
log = Logger()


@web.middleware
async def problems(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Answer every error with a problem."""
    try:
        check_headers(request)
        if not by_key(request):
            check_same_site(request)
        check_encoding(request)  # before an upload is announced
        return await handler(request)
    except ConnectionError:
        raise  # the client disconnected
    except Exception as error:  # noqa: BLE001  # the client is told of the defect; the traceback goes to the log
        told = _told(error, request)
    request[FAILED] = told.info.code
    return problem_response(told)


def _told(error: Exception, request: web.Request) -> RceError:
    """Return what the client is told about an error, from its except clause."""
    match error:
        case RceError():
            return error
        case web.HTTPNotFound():
            return NotFound(f"there is nothing at {request.path}")
        case web.HTTPException():
            headers = {name: error.headers[name] for name in ("Allow", "Accept-Encoding") if name in error.headers}
            return HttpError(error.text or error.reason, status=error.status, headers=headers)
    resource = request.match_info.route.resource  # the path itself may have a key in it
    return unexpected(error, f"{request.method} {resource.canonical if resource else request.path}")


def check_headers(request: web.Request) -> None:
    """Refuse headers that aiohttp keeps as they are, and that would fail where they are used.

    Raises:
        InvalidRequest: A header is not UTF-8, or Host does not name a host.
    """
    try:
        request.url.origin()
        for value in request.headers.values():
            value.encode()
    except ValueError:  # UnicodeEncodeError is one
        raise InvalidRequest("headers must be in UTF-8, and Host must name a host", field="Host") from None


def unexpected(error: Exception, where: str) -> RceError:
    """Log an error that was not raised on purpose, from its except clause, and return the one for the client."""
    full = service_disk_full(error)
    if full is not None:
        log.error("{where}: {error}", where=where, error=str(error))
        return full
    log.failure("defect at {where}", where=where)
    return InternalError("internal error; the service's log has the traceback")


def decode(body: bytes, kind: type[T], *, strict: bool = True) -> T:
    """Return a JSON body as a value of this type.

    Raises:
        InvalidRequest: It is malformed; `field` is the path of the value at fault (`options.resolution`).
        LimitExceeded: It has too many values.
    """
    check_value_count(body, "the body")
    try:
        return msgspec.json.decode(body, type=kind, strict=strict)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise _invalid(error, kind) from None


def convert(value: Any, kind: type[T]) -> T:
    """Return text of another form as a value of this type.

    Raises:
        InvalidRequest: As `decode`.
    """
    try:
        return msgspec.convert(value, kind, strict=False)
    except msgspec.ValidationError as error:
        raise _invalid(error, kind) from None


def _invalid(error: Exception, kind: Any) -> InvalidRequest:
    reason, path = with_choices(error, kind)
    return InvalidRequest(f"{path}: {reason}" if path else reason, field=path)
