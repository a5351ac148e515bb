"""Errors as HTTP responses: the status of each error code, and problem+json (RFC 9457)."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
from aiohttp import web

from rce.api.http import PROBLEM, Problem
from rce.errors import InvalidRequest, RceError
from rce.process.metrics import errors

STATUS = {
    "unauthorized": 401,
    "forbidden": 403,
    "not_found": 404,
    "method_not_allowed": 405,
    "already_exists": 409,
    "not_connectable": 409,
    "key_reused": 409,
    "offset_mismatch": 409,
    "start_failed": 409,
    "limit_exceeded": 413,
    "unsupported_media_type": 415,
    "upgrade_required": 426,
    "too_many_attempts": 429,
    "internal": 500,
    "error": 500,
    "no_capacity": 503,
    "unavailable": 503,
    "lost": 503,
    "timed_out": 504,
}
"""HTTP status of each error code; any other code is the client's fault (400)."""
CHALLENGE = 'Bearer realm="rce"'  # Basic would have browsers ask for a password, and send it whatever site asks


class HttpError(InvalidRequest):
    """A request that is refused with a status that its error code does not imply, or with headers."""

    def __init__(
        self, message: str, *, status: int = 0, headers: Mapping[str, str] | None = None, field: str = ""
    ) -> None:
        super().__init__(message, field=field)
        self.status = status or STATUS.get(self.code, 400)
        self.headers = headers or {}


class UnsupportedMediaType(HttpError):
    """The body is not in JSON."""

    code = "unsupported_media_type"


class MethodNotAllowed(HttpError):
    """The resource exists, and does not have this method."""

    code = "method_not_allowed"


class UpgradeRequired(HttpError):
    """The resource is for WebSockets only."""

    code = "upgrade_required"


class KeyReused(InvalidRequest):
    """The Idempotency-Key was used for another request. Take a new one for each operation."""

    code = "key_reused"


def status_of(error: RceError) -> int:
    """Return the HTTP status of an error."""
    return error.status if isinstance(error, HttpError) else STATUS.get(error.info.code, 400)


def problem_response(error: RceError) -> web.Response:
    """Return the response that describes an error, and count it."""
    info, status = error.info, status_of(error)
    errors.add("http", info.code)
    title = info.code.replace("_", " ").capitalize()
    problem = Problem(title, status, info.message, info.code, info.field, info.fields)
    headers = dict(error.headers) if isinstance(error, HttpError) else {}
    if "retry_after" in info.fields:
        headers["Retry-After"] = str(info.fields["retry_after"])
    if status == 401:
        headers["WWW-Authenticate"] = CHALLENGE
    return web.Response(status=status, body=msgspec.json.encode(problem), content_type=PROBLEM, headers=headers)
