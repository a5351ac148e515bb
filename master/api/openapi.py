"""`/api/v1/openapi.json`: the OpenAPI document of the API, from its routes and their types."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import msgspec

from master.api import live
from master.api.events import LAST_EVENT_ID
from master.api.idempotency import HEADER
from master.api.request import MAX_HEADER, Answer, Call
from master.api.router import PREFIX, Api, Route
from rce.protocol.names import Tag
from rce.web import openapi
from rce.web.openapi import Operation, Parameter

PATH = "/openapi.json"
DESCRIPTION = (
    "All resources of the platform: users and keys, robots, environments, nodes, parameters, interfaces and "
    "connections. Lists come in pages: `next` of one goes into `after` of the next. Errors are problem+json (RFC 9457) "
    "with a `code` for programs and the `field` at fault. A request with an Idempotency-Key takes effect once, however "
    "often it is sent."
)
PARAMETERS = {
    "robot": "robotID",
    "environment": "containerTag",
    "node": "nodeTag",
    "owner": "robotID or containerTag",
    "interface": "interfaceTag",
    "ownerA": "robotID or containerTag",
    "interfaceA": "interfaceTag",
    "ownerB": "robotID or containerTag",
    "interfaceB": "interfaceTag",
    "group": "group of containerData",
    "id": "id of an API key",
}
TAGS = ("robot", "environment", "node", "owner", "interface", "ownerA", "interfaceA", "ownerB", "interfaceB")
TAG = msgspec.json.schema(Tag)
TICKET = {"type": "http", "scheme": "bearer", "description": "a ticket from an earlier answer"}
HEADER_TEXT = {"type": "string", "pattern": "^[!-~]+$", "maxLength": MAX_HEADER}


class OpenApi:
    """Route of the document, which is made by the first request: few Masters are asked for it."""

    def add_to(self, api: Api) -> None:
        """Add the routes."""
        self._api = api
        api.add(Route("GET", PATH, self._show, "This document", answer=dict[str, Any], public=True))

    @cached_property
    def _document(self) -> msgspec.Raw:
        return msgspec.Raw(msgspec.json.encode(document(self._api)))

    async def _show(self, call: Call) -> Answer:
        return Answer(self._document)


def document(api: Api) -> dict[str, Any]:
    """Return the OpenAPI 3.1 document of the routes of an API."""
    schemes = {"key": openapi.KEY, "password": openapi.PASSWORD, "ticket": TICKET}
    table = [*map(_operation, api.routes), _live()]
    found = openapi.document("RCE", DESCRIPTION, table, schemes, ("key", "password"))
    bodies = [each.body for each in table if isinstance(each.body, type) and issubclass(each.body, msgspec.Struct)]
    for name in msgspec.json.schema_components(bodies)[1]:  # `Call.body` refuses unknown keys, also within
        schema = found["components"]["schemas"][name]
        if "properties" in schema:
            schema["additionalProperties"] = False
    return found


def _operation(route: Route) -> Operation:
    path = PREFIX + route.path
    answers = route.answer if isinstance(route.answer, tuple) else () if route.answer is None else (route.answer,)
    parameters = list(openapi.path_parameters(path, PARAMETERS, dict.fromkeys(TAGS, TAG)))
    if route.query is not None:
        parameters += openapi.query_parameters(route.query)
    if route.method == "POST":
        parameters.append(Parameter("header", HEADER, "the same for all retries of a request", HEADER_TEXT, False))
    if any(get.__name__ == "AsyncIterator" for each in answers if (get := getattr(each, "__origin__", None))):
        parameters.append(
            Parameter("header", LAST_EVENT_ID, "id of the last event that the client has", HEADER_TEXT, False)
        )
    security = (() if route.path == PATH else ("ticket",)) if route.public else None
    headers = {"Location": "string"} if route.status == 201 and route.query is not None else {}
    return Operation(
        *(
            route.method,
            path,
            route.summary,
            route.status,
            route.body,
            True,
            answers,
            tuple(parameters),
            headers,
            security,
        )
    )


def _live() -> Operation:
    summary = f"WebSocket: send a Greeting within {live.GREETING_TIMEOUT:g} s; Deltas follow, the first a snapshot"
    return Operation("GET", f"{PREFIX}/live", summary, 101, security=())
