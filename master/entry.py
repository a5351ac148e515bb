"""The robots' HTTP entry: `GET /?userID=…&version=…` answers with the WebSocket address of a Robot endpoint.

Status codes and their order are those of the original Rapyuta: version before userID; 400 for a missing or repeated
parameter, 410 for a client that is too old, 501 for one that is too new.
"""

from __future__ import annotations

from urllib.parse import unquote_to_bytes

import msgspec
from aiohttp import web

from master.graph.placement import robot_endpoint
from master.graph.state import State
from master.redirect import absolute_url
from rce.errors import InvalidRequest, Unavailable
from rce.protocol.messages import CURRENT_VERSION, MINIMAL_VERSION
from rce.web.requests import host_name, raw_query

BAD_REQUEST, NOT_FOUND, METHOD_NOT_ALLOWED, GONE, NOT_IMPLEMENTED, UNAVAILABLE = 400, 404, 405, 410, 501, 503


class Entry:
    """Answers every path as `/`, as the original does."""

    def __init__(self, state: State) -> None:
        self._state = state

    def handle(self, request: web.BaseRequest) -> web.Response:
        """Answer a request, whatever its path."""
        if request.method not in ("GET", "HEAD"):
            response = text_response(METHOD_NOT_ALLOWED, "the entry is read by robots: use GET")
            response.headers["Allow"] = "GET, HEAD"
            return response
        response = self._answer(request)
        response.headers["Access-Control-Allow-Origin"] = "*"  # the answer is no secret and needs no credentials
        return response

    def _answer(self, request: web.BaseRequest) -> web.Response:
        parameters = query_parameters(raw_query(request))
        if not parameters and "text/html" in request.headers.get("Accept", ""):  # a person's browser, and no robot
            return text_response(NOT_FOUND, "there is no such page: the dashboard is at /ui/")
        try:
            version = _single(parameters, "version")
            if version < MINIMAL_VERSION:
                return text_response(GONE, f"version {version} is too old: the minimum is {MINIMAL_VERSION}")
            if version > CURRENT_VERSION:
                return text_response(NOT_IMPLEMENTED, f"version {version} is newer than {CURRENT_VERSION}")
            _single(parameters, "userID")
            answer = {"url": absolute_url(robot_endpoint(self._state).url, host_name(request))}
        except InvalidRequest as error:
            return text_response(BAD_REQUEST, str(error))
        except Unavailable as error:
            return text_response(UNAVAILABLE, str(error))
        if version < CURRENT_VERSION:
            answer["current"] = CURRENT_VERSION
        return web.Response(body=msgspec.json.encode(answer), content_type="application/json", charset="utf-8")


def query_parameters(query: str) -> dict[str, list[bytes]]:
    """Return the parameters as the original parses them: `;` separates as well, and a name without `=` is ignored."""
    found: dict[str, list[bytes]] = {}
    for item in query.replace(";", "&").split("&"):
        name, equals, value = item.replace("+", " ").partition("=")
        if equals:
            found.setdefault(_unquote(name).decode("utf-8", "replace"), []).append(_unquote(value))
    return found


def _unquote(text: str) -> bytes:
    return unquote_to_bytes(text.encode("utf-8", "surrogateescape"))


def _single(parameters: dict[str, list[bytes]], name: str) -> str:
    values = parameters.get(name, [])
    if len(values) != 1:
        raise InvalidRequest(f"parameter {name} must be given exactly once; it is given {len(values)} times")
    try:
        return values[0].decode()
    except UnicodeDecodeError:
        raise InvalidRequest(f"parameter {name} is not UTF-8") from None


def text_response(status: int, reason: str) -> web.Response:
    """Return a response of one line of text."""
    return web.Response(status=status, text=reason + "\n", content_type="text/plain", charset="utf-8")
