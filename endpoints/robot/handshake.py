"""The request that opens a robot's WebSocket: what it says, and the HTTP status that refuses it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from endpoints.robot.door import Greeting
from rce.errors import (
    AlreadyExists,
    Forbidden,
    InternalError,
    InvalidRequest,
    NotFound,
    RceError,
    TimedOut,
    TooManyAttempts,
    Unauthorized,
    Unavailable,
)
from rce.messages import FEATURES


class Request(Protocol):
    """A request as Autobahn has it."""

    peer: Any  # its address, as tcp4:HOST:PORT
    headers: Mapping[str, Any]  # in lower case
    params: Mapping[str, list[Any]]  # of the query, each with all its values


def read_request(request: Request) -> Greeting:
    """InvalidRequest if a parameter is missing or repeated."""
    header = str(request.headers.get("authorization", ""))
    scheme, _, bearer = header.partition(" ")
    secret = bearer.strip() if scheme.lower() == "bearer" else _one(request, "password", "key")
    offered = _optional(request, "features").split(",")
    user = _one(request, "userID")
    return Greeting(
        user=user,
        robot=_one(request, "robotID"),
        secret=secret,
        features=FEATURES & frozenset(offered),
        resume=_optional(request, "resume"),
        compress=_compress(_optional(request, "compress")),
        address=str(request.peer),
        owner=_optional(request, "owner") or user,
    )


def _one(request: Request, *names: str) -> str:
    values = [value for name in names for value in request.params.get(name, [])]
    if len(values) != 1:
        raise InvalidRequest(f"parameter {' or '.join(names)} must be given exactly once, not {len(values)} times")
    return str(values[0])


def _optional(request: Request, name: str) -> str:
    values = request.params.get(name, [""])
    if len(values) != 1:
        raise InvalidRequest(f"parameter {name} must be given at most once, not {len(values)} times")
    return str(values[0])


def hears_by_closing(request: Request) -> bool:
    """Browsers tell scripts neither status nor reason of a handshake that was refused, but those of a closed socket."""
    return "close" in request.params.get("refuse", [])


def _compress(value: str) -> bool:
    if value not in ("", "deflate"):
        raise InvalidRequest(f"parameter compress may be deflate, not {value[:40]!r}")
    return bool(value)


def refusal_status(error: RceError, features: frozenset[str]) -> int:
    """Clients of the original know 400 and 401; those with features can tell a robotID in use from a bad request."""
    if isinstance(error, AlreadyExists) and features:
        return 409
    if isinstance(error, NotFound) and features:  # no such owner
        return 404
    if isinstance(error, Unauthorized):
        return 401
    if isinstance(error, TooManyAttempts):
        return 429
    if isinstance(error, Forbidden):
        return 403
    if isinstance(error, Unavailable | TimedOut):
        return 503
    if isinstance(error, InternalError):
        return 500
    return 400
