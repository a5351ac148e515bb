"""How errors go out over HTTP: status codes, and problem+json (RFC 9457)."""

from __future__ import annotations

import msgspec
from twisted.web.server import Request

from rce.errors import InvalidRequest, RceError
from rce.http import PROBLEM, Problem
from rce.metrics import errors

STATUS = {
    "unauthorized": 401,
    "too_many_attempts": 429,
    "forbidden": 403,
    "not_found": 404,
    "method_not_allowed": 405,
    "already_exists": 409,
    "not_connectable": 409,
    "key_reused": 409,
    "start_failed": 409,
    "limit_exceeded": 413,
    "unsupported_media_type": 415,
    "upgrade_required": 426,
    "no_capacity": 503,
    "unavailable": 503,
    "lost": 503,
    "timed_out": 504,
    "internal": 500,
    "error": 500,
}
"""Status codes by those of errors; every other error is the asker's (400)."""


class UnsupportedMediaType(InvalidRequest):
    """The body is not in JSON."""

    code = "unsupported_media_type"


class MethodNotAllowed(InvalidRequest):
    """The resource is there, and cannot be asked that."""

    code = "method_not_allowed"


class KeyReused(InvalidRequest):
    """The Idempotency-Key was used for another request. Take a new one for each thing that is wanted."""

    code = "key_reused"


def status_of(error: RceError) -> int:
    return STATUS.get(error.info.code, 400)


def refuse(request: Request, error: RceError) -> None:
    """Answer with what is wrong."""
    info, status = error.info, status_of(error)
    errors.add("http", info.code)
    title = info.code.replace("_", " ").capitalize()
    problem = Problem(title, status, info.message, info.code, info.field, info.fields)
    request.setResponseCode(status)
    if "retry_after" in info.fields:
        request.setHeader("retry-after", str(info.fields["retry_after"]))
    if status == 401:
        request.setHeader("www-authenticate", 'Basic realm="rce"')
    write(request, msgspec.json.encode(problem), PROBLEM)


def write(request: Request, body: bytes, kind: str) -> None:
    """A whole answer."""
    request.setHeader("content-type", kind)
    request.setHeader("content-length", str(len(body)))
    request.write(body)
    request.finish()
