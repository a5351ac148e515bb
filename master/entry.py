"""The HTTP entry: `GET /?userID=…&version=…` tells a robot the WebSocket address of a Robot endpoint.

What begins with the name of a service (`/map-service/…`) is redirected there.

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
        self.state = state

    def render(self, request: Request) -> bytes | int:
        try:
            location = self.location(request.uri, request.getRequestHostname())
        except Unavailable as error:
            return _refuse(request, http.SERVICE_UNAVAILABLE, str(error))
        if not location and request.method not in (b"GET", b"HEAD"):
            request.setHeader("allow", "GET, HEAD")  # Twisted would say 501 to most: that it knows no such method
            return _refuse(request, http.NOT_ALLOWED, "this is read by robots only: GET")
        if not location:
            return super().render(request)  # type: ignore[no-any-return, no-untyped-call]  # Twisted's
        request.setResponseCode(http.TEMPORARY_REDIRECT)
        request.setHeader("location", location)
        return b""

    def location(self, uri: bytes, host: bytes) -> bytes:
        """Where a service answers this, if its path begins with the name of one. Unavailable while that is away."""
        name = uri.lstrip(b"/").partition(b"?")[0].partition(b"/")[0].decode("ascii", "replace")
        service = self.state.processes.get(name)
        if service is None or service.role != "service":
            return b""
        if name not in self.state.joined:
            raise Unavailable(f"the service {name} is away at present; try again in a moment")
        return absolute(service.url, host).rstrip("/").encode() + b"/" + uri.lstrip(b"/")

    def render_GET(self, request: Request) -> bytes:
        request.setHeader("access-control-allow-origin", "*")  # what it tells is no secret, and it takes no credential
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
        return absolute(robot_endpoint(self.state).url, request.getRequestHostname())


def absolute(url: str, host: bytes) -> str:
    """The address of a process; where none is configured, on the host that brought the client here."""
    scheme, _, rest = url.partition("://")
    if rest.startswith(":"):
        name = host.decode("ascii", "replace")
        rest = (f"[{name}]" if ":" in name else name) + rest
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
