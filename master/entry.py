"""The HTTP entry: `GET /?userID=…&version=…` tells a robot the WebSocket address of a Robot endpoint.

Status codes and their order are the original's: version before userID; 400 for a missing or repeated parameter, 410 for
a client that is too old, 501 for one that is too new.
"""

from __future__ import annotations

import msgspec
from twisted.web import http
from twisted.web.resource import Resource
from twisted.web.server import Request

from master.placement import robot_endpoint
from master.records import State
from rce.errors import InvalidRequest, Unavailable
from rce.messages import CURRENT_VERSION, MINIMAL_VERSION


class Entry(Resource):
    """Any path answers as `/` does, as in the original."""

    isLeaf = True

    def __init__(self, state: State) -> None:
        super().__init__()  # type: ignore[no-untyped-call]  # Twisted's
        self._state = state

    def render_GET(self, request: Request) -> bytes:
        try:
            version = _parameter(request, "version")
            if version < MINIMAL_VERSION:
                return _refuse(request, http.GONE, f"version {version} is too old: {MINIMAL_VERSION} is the least")
            if version > CURRENT_VERSION:
                return _refuse(request, http.NOT_IMPLEMENTED, f"version {version} is newer than {CURRENT_VERSION}")
            _parameter(request, "userID")
            answer = {"url": self._url(request)}
        except InvalidRequest as error:
            return _refuse(request, http.BAD_REQUEST, str(error))
        except Unavailable as error:
            return _refuse(request, http.SERVICE_UNAVAILABLE, str(error))
        if version < CURRENT_VERSION:
            answer["current"] = CURRENT_VERSION
        request.setHeader("content-type", "application/json; charset=utf-8")
        return msgspec.json.encode(answer)

    def _url(self, request: Request) -> str:
        url = robot_endpoint(self._state).url
        scheme, _, rest = url.partition("://")
        if rest.startswith(":"):  # no public address configured: the one that brought the robot here
            host = request.getRequestHostname().decode("ascii", "replace")
            rest = (f"[{host}]" if ":" in host else host) + rest
        return f"{scheme}://{rest}"


def _parameter(request: Request, name: str) -> str:
    values = request.args.get(name.encode(), []) if request.args else []
    if len(values) != 1:
        raise InvalidRequest(f"parameter {name} must be given exactly once; it is given {len(values)} times")
    try:
        return str(values[0], "utf-8")
    except UnicodeDecodeError:
        raise InvalidRequest(f"parameter {name} is not UTF-8") from None


def _refuse(request: Request, status: int, reason: str) -> bytes:
    request.setResponseCode(status)
    request.setHeader("content-type", "text/plain; charset=utf-8")
    return (reason + "\n").encode()
