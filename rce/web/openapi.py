"""OpenAPI 3.1 documents, from tables of operations with the types of their bodies and answers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple, get_origin

import msgspec
from aiohttp import web

import rce
from rce.api.http import PROBLEM, Problem
from rce.schemas import normalized

REF = "#/components/schemas/{name}"
EVENTS = "text/event-stream"
BYTES = "application/octet-stream"
JSON = "application/json"
KEY: dict[str, Any] = {"type": "http", "scheme": "bearer", "description": "an API key"}
PASSWORD: dict[str, Any] = {"type": "http", "scheme": "basic", "description": "user and password, or API key"}
QUERY: dict[str, Any] = {"type": "apiKey", "in": "query", "name": "key", "description": "an API key"}
SCHEMES = {"key": KEY, "password": PASSWORD, "query": QUERY}
"""Security schemes of the map service and the knowledge service."""


class Parameter(NamedTuple):
    """A parameter; `location` is path, query or header."""

    location: str
    name: str
    description: str
    schema: dict[str, Any]
    required: bool = True


class Operation(NamedTuple):
    """A method of a path.

    `body` and `answers` are types, for JSON, or media types. `answer_headers` have the JSON type of each header. One of
    the schemes in `security` is required, or one of the document's if it is None.
    """

    method: str
    path: str
    summary: str
    status: int = 200
    body: Any = None
    body_required: bool = True
    answers: tuple[Any, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    answer_headers: dict[str, str] = {}  # noqa: RUF012  # never changed
    security: tuple[str, ...] | None = None

    @property
    def id(self) -> str:
        """Return a unique name of the operation."""
        return f"{self.method.lower()}{re.sub('[^A-Za-z]+', '_', self.path)}".rstrip("_")


def document(
    title: str, description: str, table: Iterable[Operation], schemes: dict[str, Any], default: Iterable[str]
) -> dict[str, Any]:
    """Return a document.

    Args:
        title: Name of the API.
        description: What it is for.
        table: Its operations.
        schemes: Security schemes by their names.
        default: Schemes one of which is required unless an operation says otherwise.
    """
    table = list(table)
    kinds = [kind for each in table for kind in (each.body, *each.answers) if kind is not None and _media(kind) == JSON]
    found, components = msgspec.json.schema_components([Problem, *kinds], ref_template=REF)
    schemas = iter(found)
    problem = next(schemas)
    paths: dict[str, Any] = {}
    for each in table:
        body = _content([each.body], schemas) if each.body is not None else None
        paths.setdefault(each.path, {})[each.method.lower()] = _operation(
            each, body, _content(each.answers, schemas), problem
        )
    return {
        "openapi": "3.1.0",
        "info": {"title": title, "version": rce.__version__, "description": description},
        "paths": paths,
        "components": {"schemas": normalized(components), "securitySchemes": schemes},
        "security": [{name: []} for name in default],
    }


def serve(application: web.Application, prefix: str, content: dict[str, Any]) -> None:
    """Serve a document at `prefix` and at `prefix/openapi.json`."""
    text = msgspec.json.format(msgspec.json.encode(content), indent=1)

    async def describe(_: web.Request) -> web.Response:
        return web.Response(body=text, content_type=JSON)

    for path in ("", "/", "/openapi.json"):
        application.router.add_get(prefix + path, describe)


def path_parameters(
    path: str, described: dict[str, str], schemas: dict[str, dict[str, Any]] | None = None
) -> tuple[Parameter, ...]:
    """Return the parameters `{name}` of a path: any text, unless `schemas` has more for a name."""
    text = {"type": "string", "minLength": 1}
    return tuple(
        Parameter("path", name, described.get(name, ""), (schemas or {}).get(name, text))
        for name in re.findall(r"{(\w+)}", path)
    )


def query_parameters(kind: type[msgspec.Struct]) -> tuple[Parameter, ...]:
    """Return the fields of a type as parameters; those with a default are optional."""
    _, components = msgspec.json.schema_components([kind])
    described = components[kind.__name__]
    found = []
    for name, schema in described.get("properties", {}).items():
        options = [option for option in schema.get("anyOf", ()) if option != {"type": "null"}]
        if len(options) == 1:  # there is no null in a query
            schema = {key: value for key, value in schema.items() if key != "anyOf"} | options[0]
        schema = {key: value for key, value in schema.items() if (key, value) != ("default", None)}
        found.append(Parameter("query", name, schema.pop("description", ""), schema, name in described["required"]))
    return tuple(found)


def _media(kind: Any) -> str:
    if isinstance(kind, str):
        return kind
    if kind is Path:
        return BYTES
    return EVENTS if getattr(get_origin(kind), "__name__", "") == "AsyncIterator" else JSON


def _content(kinds: Iterable[Any], schemas: Any) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for kind in kinds:
        media = _media(kind)
        found[media] = {"schema": next(schemas) if media == JSON else {"type": "string"} if media == EVENTS else {}}
    return found


def _operation(each: Operation, body: dict[str, Any] | None, content: dict[str, Any], problem: Any) -> dict[str, Any]:
    good: dict[str, Any] = {"description": "see the schema" if content else "done"}
    if content:
        good["content"] = content
    if each.answer_headers:
        good["headers"] = {name: {"schema": {"type": kind}} for name, kind in each.answer_headers.items()}
    operation: dict[str, Any] = {
        "operationId": each.id,
        "summary": each.summary,
        "responses": {
            str(each.status): good,
            "default": {"description": "refused", "content": {PROBLEM: {"schema": problem}}},
        },
    }
    if each.parameters:
        operation["parameters"] = [
            {"in": location, "name": name, "required": required, "description": text, "schema": schema}
            for location, name, text, schema, required in each.parameters
        ]
    if body is not None:
        operation["requestBody"] = {"required": each.body_required, "content": body}
    if each.security is not None:
        operation["security"] = [{name: []} for name in each.security]
    return operation
