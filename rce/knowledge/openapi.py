"""Operations of the REST interface in one table, from which the routes and the OpenAPI document are made."""

from __future__ import annotations

from typing import Any, NamedTuple

from aiohttp import web
from aiohttp.typedefs import Handler

from rce.api.knowledge import (
    PREFIX,
    Entry,
    EntryChange,
    EntryPage,
    Imported,
    NewEntry,
    QueryRequest,
    QueryResult,
    Rating,
    Usage,
    Version,
)
from rce.knowledge.changes import Subscription
from rce.knowledge.rest import Rest
from rce.knowledge.search import Search
from rce.web import openapi
from rce.web.openapi import BYTES, EVENTS

ZIP = "application/zip"
PARAMETERS = {
    "kind": "recipe, object or environment",
    "uid": "`class.id` in lower case",
    "version": "number of a version",
    "file": "name of a file",
}
VERSION = openapi.Parameter("query", "version", "number of a version; default: the newest", {"type": "integer"}, False)
LAST = openapi.Parameter("header", "Last-Event-ID", "as `after`, of a client that resumes", {"type": "integer"}, False)


class Route(NamedTuple):
    """A method of a path with its handler; `body` and `answer` are types, for JSON, or media types."""

    method: str
    path: str
    handler: Handler
    summary: str
    status: int = 200
    body: Any = None
    answer: Any = None
    parameters: tuple[openapi.Parameter, ...] = ()


def routes(rest: Rest) -> list[Route]:
    """Return the table."""
    entry = "/entries/{kind}/{uid}"
    return [
        Route(
            "GET",
            "/entries",
            rest.search,
            "Entries that fit",
            answer=EntryPage,
            parameters=openapi.query_parameters(Search),
        ),
        Route("POST", "/entries", rest.add, "Add an entry", 201, NewEntry, Entry),
        Route("GET", entry, rest.show, "An entry", answer=Entry),
        Route("PATCH", entry, rest.change, "Change an entry of yours", body=EntryChange, answer=Entry),
        Route("DELETE", entry, rest.remove, "Remove an entry of yours with all versions", 204),
        Route("POST", entry + "/rating", rest.rate, "Rate an entry", body=Rating, answer=Entry),
        Route("GET", entry + "/owl", rest.owl, "The OWL text of a version", answer=BYTES, parameters=(VERSION,)),
        Route("GET", entry + "/versions", rest.versions, "All versions, newest first", answer=list[Version]),
        Route("DELETE", entry + "/versions/{version}", rest.remove_version, "Remove an old version", 204),
        Route("PUT", entry + "/files/{file}", rest.put_file, "Add or replace a file", body=BYTES, answer=Entry),
        Route("GET", entry + "/files/{file}", rest.file, "A file of a version", answer=BYTES, parameters=(VERSION,)),
        Route("DELETE", entry + "/files/{file}", rest.remove_file, "Remove a file; old versions keep it", answer=Entry),
        Route("POST", "/query", rest.query, "Answer a query", body=QueryRequest, answer=QueryResult),
        Route(
            *("GET", "/changes", rest.changes, "Changes from now on, as server-sent events `change`"),
            answer=EVENTS,
            parameters=(*openapi.query_parameters(Subscription), LAST),
        ),
        Route("GET", "/usage", rest.usage, "Your use of the quota", answer=Usage),
        Route("GET", "/archive", rest.export, "All entries that you may read, as an archive", answer=ZIP),
        Route("POST", "/archive", rest.restore, "Add the entries of an archive", body=ZIP, answer=Imported),
    ]


def document(table: list[Route]) -> dict[str, Any]:
    """Return the OpenAPI 3.1 document."""
    description = "Action recipes, objects and environments that robots share: OWL texts with files, in versions."
    return openapi.document(
        "RCE knowledge service", description, map(_operation, table), openapi.SCHEMES, openapi.SCHEMES
    )


def _operation(route: Route) -> openapi.Operation:
    path = PREFIX + route.path
    return openapi.Operation(
        route.method,
        path,
        route.summary,
        route.status,
        route.body,
        answers=() if route.answer is None else (route.answer,),
        parameters=(*openapi.path_parameters(path, PARAMETERS), *route.parameters),
    )


def add(application: web.Application, table: list[Route]) -> None:
    """Add the routes, and the document that describes them."""
    for route in table:
        application.router.add_route(route.method, PREFIX + route.path, route.handler)
    openapi.serve(application, PREFIX, document(table))
