"""OpenAPI documents from tables of operations."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any

import pytest
from msgspec import Meta, Struct
from openapi_spec_validator import validate

from rce.web.openapi import BYTES, EVENTS, KEY, PASSWORD, Operation, document, path_parameters, query_parameters


class Thing(Struct):
    name: str
    size: int = 0


class Query(Struct):
    text: str
    limit: Annotated[int, Meta(ge=1, le=1000, description="number of items")] = 100
    after: str | None = None
    since: Annotated[float, Meta(description="seconds")] | None = None
    state: Annotated[str | int | None, Meta(description="of the thing")] = None


TABLE = [
    Operation("GET", "/things", "list", answers=(list[Thing],), parameters=query_parameters(Query)),
    Operation("POST", "/things", "create", 201, Thing, answers=(Thing,), answer_headers={"Location": "string"}),
    Operation(
        "PUT",
        "/things/{name}",
        "upload",
        204,
        BYTES,
        body_required=False,
        parameters=path_parameters("/things/{name}", {}),
    ),
    Operation("GET", "/events", "follow", answers=(AsyncIterator[Thing],), security=("password",)),
    Operation("GET", "/file", "download", answers=(Path,), security=()),
]


@pytest.fixture
def made() -> dict[str, Any]:
    return document("things", "Things.", iter(TABLE), {"key": KEY, "password": PASSWORD}, ["key", "password"])


def test_document_is_valid(made: dict[str, Any]) -> None:
    validate(made)


def test_each_operation_has_its_path_method_and_id(made: dict[str, Any]) -> None:
    found = {
        (path, method): each["operationId"]
        for path, methods in made["paths"].items()
        for method, each in methods.items()
    }
    assert found == {
        ("/things", "get"): "get_things",
        ("/things", "post"): "post_things",
        ("/things/{name}", "put"): "put_things_name",
        ("/events", "get"): "get_events",
        ("/file", "get"): "get_file",
    }


def test_bodies_and_answers_refer_to_their_types(made: dict[str, Any]) -> None:
    thing = {"$ref": "#/components/schemas/Thing"}
    post = made["paths"]["/things"]["post"]
    assert post["requestBody"] == {"required": True, "content": {"application/json": {"schema": thing}}}
    assert post["responses"]["201"] == {
        "description": "see the schema",
        "content": {"application/json": {"schema": thing}},
        "headers": {"Location": {"schema": {"type": "string"}}},
    }
    listed = made["paths"]["/things"]["get"]["responses"]["200"]["content"]["application/json"]["schema"]
    assert listed == {"type": "array", "items": thing}
    assert made["components"]["schemas"]["Thing"]["required"] == ["name"]


def test_bodies_that_are_not_json_have_media_types(made: dict[str, Any]) -> None:
    put = made["paths"]["/things/{name}"]["put"]
    assert put["requestBody"] == {"required": False, "content": {BYTES: {"schema": {}}}}
    assert put["responses"]["204"] == {"description": "done"}
    events, file = made["paths"]["/events"]["get"], made["paths"]["/file"]["get"]
    assert events["responses"]["200"]["content"] == {EVENTS: {"schema": {"type": "string"}}}
    assert file["responses"]["200"]["content"] == {BYTES: {"schema": {}}}


def test_every_operation_may_be_refused_with_a_problem(made: dict[str, Any]) -> None:
    for methods in made["paths"].values():
        for each in methods.values():
            schema = each["responses"]["default"]["content"]["application/problem+json"]["schema"]
            assert schema == {"$ref": "#/components/schemas/Problem"}


def test_security_of_an_operation_replaces_that_of_the_document(made: dict[str, Any]) -> None:
    assert made["security"] == [{"key": []}, {"password": []}]
    assert "security" not in made["paths"]["/things"]["get"]
    assert made["paths"]["/events"]["get"]["security"] == [{"password": []}]
    assert made["paths"]["/file"]["get"]["security"] == []


def test_query_parameters_with_a_default_are_optional_and_never_null() -> None:
    found = {each.name: each for each in query_parameters(Query)}
    assert {each.location for each in found.values()} == {"query"}
    assert [name for name, each in found.items() if each.required] == ["text"]
    assert found["limit"].schema == {"type": "integer", "minimum": 1, "maximum": 1000, "default": 100}
    assert found["limit"].description == "number of items"
    assert found["after"].schema == {"type": "string"}
    assert (found["since"].schema, found["since"].description) == ({"type": "number"}, "seconds")


def test_path_parameters_may_have_their_own_schema() -> None:
    user, name = path_parameters("/{user}/x/{name}", {"user": "owner"}, {"name": {"type": "string", "maxLength": 3}})
    assert (user.location, user.description, user.required) == ("path", "owner", True)
    assert user.schema == {"type": "string", "minLength": 1}
    assert (name.description, name.schema) == ("", {"type": "string", "maxLength": 3})
    assert path_parameters("/x", {}) == ()
