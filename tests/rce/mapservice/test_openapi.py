"""OpenAPI document of the map service."""

from __future__ import annotations

from typing import Any

import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator

from tests.support.map_service import Service


@pytest.fixture
async def document(service: Service) -> Any:
    return await (await service.session.get(service.url + "/openapi.json")).json()


async def test_document_is_valid_openapi(document: Any) -> None:
    OpenAPIV31SpecValidator(document).validate()


async def test_document_describes_every_route(service: Service, document: Any) -> None:
    described = {(method.upper(), path) for path, found in document["paths"].items() for method in found}
    routes = {
        (route.method, route.resource.canonical)
        for route in service.service._runner.app.router.routes()
        if route.resource is not None and "soap" not in route.resource.canonical
    }
    own = {
        (method, path)
        for method, path in routes
        if path.rstrip("/") not in ("/map-service", "/map-service/openapi.json", "/healthz", "/readyz")
    }
    assert described == own


async def test_document_has_the_limits_of_the_types(document: Any) -> None:
    job = document["components"]["schemas"]["Job"]
    assert set(job["properties"]["state"]["enum"]) >= {"queued", "done"}
    assert document["components"]["schemas"]["MapOptions"]["properties"]["resolution"]["maximum"] == 0.5


async def test_only_public_routes_need_no_credentials(document: Any) -> None:
    public = {
        (method, path)
        for path, found in document["paths"].items()
        for method, operation in found.items()
        if operation.get("security") == []
    }
    assert public == {("options", "/map-service/uploads")}
    assert {name for choice in document["security"] for name in choice} == {"key", "password", "query"}


async def test_headers_of_an_upload_are_described(document: Any) -> None:
    announce = document["paths"]["/map-service/uploads"]["post"]
    assert {each["name"] for each in announce["parameters"]} == {"Upload-Length", "Upload-Metadata"}
    assert set(announce["responses"]["201"]["headers"]) == {"Upload-Offset", "Upload-Length"}
    assert not announce["requestBody"].get("required", False), "the file may follow later"


async def test_document_is_also_the_root_of_the_interface(service: Service, document: Any) -> None:
    for path in ("", "/"):
        answer = await service.session.get(service.url + path)
        assert await answer.json() == document
