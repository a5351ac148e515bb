"""Parsing of the HTTP request that opens a robot's WebSocket, and the HTTP status of its refusal."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Protocol

from msgspec import Struct

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
from rce.protocol.messages import FEATURES


class Request(Protocol):
    """HTTP request as Autobahn represents it."""

    peer: Any  # address of the client, as tcp4:HOST:PORT
    headers: Mapping[str, Any]  # names in lower case
    params: Mapping[str, list[Any]]  # query parameters, each with all its values


class LoginRequest(Struct, frozen=True):
    """Parameters of the HTTP request that opens a robot's WebSocket."""

    user: str
    robot: str
    secret: str
    features: frozenset[str]
    resume: str
    compress: bool
    address: str
    owner: str  # the user to whom the robot belongs

    @property
    def name(self) -> str:
        """Name of the robot inside the platform: `owner/robotID`."""
        return f"{self.owner}/{self.robot}"


def parse_login(request: Request) -> LoginRequest:
    """Return the login parameters of a request.

    Raises:
        InvalidRequest: A parameter is missing, repeated or has an unknown value.
    """
    user = _one(request, "userID")
    return LoginRequest(
        user=user,
        robot=_one(request, "robotID"),
        secret=_secret(request),
        features=_features(optional(request, "features")),
        resume=optional(request, "resume"),
        compress=_compress(optional(request, "compress")),
        address=str(request.peer),
        owner=optional(request, "owner") or user,
    )


@lru_cache(100)
def _features(offered: str) -> frozenset[str]:
    """Return the features of a list that the server has; thousands of robots ask for the same, and share them."""
    return FEATURES & frozenset(offered.split(","))


def parse_guest(request: Request) -> tuple[str, str]:
    """Return the userID and the secret of a request without a robotID; raises InvalidRequest."""
    return _one(request, "userID"), _secret(request)


def _secret(request: Request) -> str:
    scheme, _, bearer = str(request.headers.get("authorization", "")).partition(" ")
    return bearer.strip() if scheme.lower() == "bearer" else _one(request, "password", "key")


def _one(request: Request, *names: str) -> str:
    values = [value for name in names for value in request.params.get(name, [])]
    if len(values) != 1:
        raise InvalidRequest(f"parameter {' or '.join(names)} must be given exactly once, not {len(values)} times")
    return str(values[0])


def optional(request: Request, name: str) -> str:
    """Return a parameter, or an empty string; raises InvalidRequest if it is given more than once."""
    values = request.params.get(name, [""])
    if len(values) != 1:
        raise InvalidRequest(f"parameter {name} must be given at most once, not {len(values)} times")
    return str(values[0])


def wants_close_code(request: Request) -> bool:
    """Return True if the client asks for a refusal as a close code after the handshake.

    Browsers hide the status and reason of a refused handshake from scripts, but not those of a closed socket.
    """
    return "close" in request.params.get("refuse", [])


def _compress(value: str) -> bool:
    if value not in ("", "deflate"):
        raise InvalidRequest(f"parameter compress must be deflate or absent, not {value[:40]!r}")
    return bool(value)


def refusal_status(error: RceError, features: frozenset[str]) -> int:
    """Return the HTTP status with which a login is refused.

    Clients of the original protocol know 400 and 401 only. Clients with features get 409 for a robotID in use and 404
    for an unknown owner.
    """
    if isinstance(error, AlreadyExists) and features:
        return 409
    if isinstance(error, NotFound) and features:  # the owner does not exist
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
