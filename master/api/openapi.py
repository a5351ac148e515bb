"""`/api/v1/openapi.json`: what the API offers, out of its routes and their types."""

from __future__ import annotations

from typing import Any

import msgspec

from master.api import live
from master.api.calls import LONGEST, Answer, Call
from master.api.events import LAST
from master.api.repeats import HEADER
from master.api.router import PREFIX, Api, Route
from rce import openapi
from rce.messages import Tag
from rce.openapi import Operation, Parameter

PATH = "/openapi.json"
DESCRIPTION = (
    "Everything that the platform is made of: users and keys, robots, environments, what is in them, and what connects "
    "them. Lists come in pages: `next` of one goes into `after` of the next. Errors are problem+json (RFC 9457) with a "
    "`code` for programs and the `field` at fault. What is made with an Idempotency-Key is made once, however often "
    "the request is sent with it."
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
    "group": "of containerData",
    "id": "id of an API key",
}
TAGS = ("robot", "environment", "node", "owner", "interface", "ownerA", "interfaceA", "ownerB", "interfaceB")
TAG = msgspec.json.schema(Tag)
TICKET = {"type": "http", "scheme": "bearer", "description": "a ticket, as the request before got it"}
VISIBLE = {"type": "string", "pattern": "^[!-~]+$", "maxLength": LONGEST}


class OpenApi:
    """The document; to be added last, for it has what was added before."""

    def add_to(self, api: Api) -> None:
        api.add(Route("GET", PATH, self.show, "This document", answer=dict[str, Any], for_all=True))
        self._document = msgspec.Raw(msgspec.json.encode(document(api)))

    async def show(self, call: Call) -> Answer:
        return Answer(self._document)


def document(api: Api) -> dict[str, Any]:
    """The OpenAPI 3.1 document of all that was added."""
    schemes = {"key": openapi.KEY, "password": openapi.PASSWORD, "ticket": TICKET}
    table = [*map(_operation, api.routes), _live()]
    return openapi.document("RCE", DESCRIPTION, table, schemes, ("key", "password"))


def _operation(route: Route) -> Operation:
    path = PREFIX + route.path
    answers = route.answer if isinstance(route.answer, tuple) else () if route.answer is None else (route.answer,)
    parameters = list(openapi.path_parameters(path, PARAMETERS, dict.fromkeys(TAGS, TAG)))
    if route.query is not None:
        parameters += openapi.query_parameters(route.query)
    if route.method == "POST":
        parameters.append(Parameter("header", HEADER, "of this request and its repetitions", VISIBLE, False))
    if any(get.__name__ == "AsyncIterator" for each in answers if (get := getattr(each, "__origin__", None))):
        parameters.append(Parameter("header", LAST, "go on after this one", VISIBLE, False))
    security = (() if route.path == PATH else ("ticket",)) if route.for_all else None
    told = {"Location": "string"} if route.status == 201 and route.query is not None else {}
    return Operation(
        *(route.method, path, route.summary, route.status, route.body, True, answers, tuple(parameters), told, security)
    )


def _live() -> Operation:
    summary = f"A WebSocket: send a Greeting within {live.GREETING:g} s; Deltas come, the first a snapshot"
    return Operation("GET", f"{PREFIX}/live", summary, 101, security=())
