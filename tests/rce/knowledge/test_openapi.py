"""OpenAPI document of the knowledge service."""

from __future__ import annotations

from openapi_spec_validator import OpenAPIV31SpecValidator

from tests.support.knowledge import Service


async def test_document_is_valid_and_describes_every_route(service: Service) -> None:
    document = await (await service.session.get(service.url + "/openapi.json")).json()
    OpenAPIV31SpecValidator(document).validate()
    described = {(method.upper(), path) for path, found in document["paths"].items() for method in found}
    routes = {
        (route.method, route.resource.canonical)
        for route in service.service._runner.app.router.routes()
        if route.resource is not None and route.method != "HEAD" and "/api/0.1" not in route.resource.canonical
    }
    assert described == {(method, path) for method, path in routes if "{" in path or path.count("/") > 1} - {
        ("GET", "/knowledge-service/"),
        ("GET", "/knowledge-service/openapi.json"),
    }
    names = {each["name"] for each in document["paths"]["/knowledge-service/entries"]["get"]["parameters"]}
    assert {"class", "prefix", "text", "latitude"} <= names
