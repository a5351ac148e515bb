"""Paths of RoboEarth's repository, as its clients use them."""

from __future__ import annotations

from typing import Any

import aiohttp
import pytest
from twisted.logger import LogEvent

from rce.knowledge import original
from tests.support.knowledge import BED, CUP, Service

KEY = "rce_ann"


async def call(service: Service, method: str, path: str, status: int = 200, **more: Any) -> Any:
    answer = await service.request(method, f"{service.root}/api/0.1/{path}", "", **more)
    assert answer.status == status, await answer.text()
    return await answer.json() if status == 200 else None


async def add(service: Service, kind: str, text: str, status: int = 200, **more: Any) -> Any:
    body = {"api_key": KEY, "id": "Blue", "class": "Cup", "description": "a cup", text: CUP, **more}
    return await call(service, "POST", kind, status, json=body)


@pytest.mark.parametrize(
    ("kind", "text", "listed"),
    [
        ("recipe", "recipe", "recipes"),
        ("object", "object_description", "object_description"),
        ("environment", "environment", "environments"),
    ],
)
async def test_entry_is_added_changed_found_by_prefix_rated_and_removed(
    service: Service, kind: str, text: str, listed: str
) -> None:
    record = await add(service, kind, text, latitude=1.0, longitude=2.0)
    assert (record["id"], record["author"], record["location"]) == ("cup.blue", "ann", {"latitude": 1, "longitude": 2})
    assert record[listed][0]["description"] == CUP
    for _ in range(3):
        await call(service, "PUT", f"{kind}/cup.blue", json={"api_key": KEY, text: BED})
    (found,) = await call(service, "GET", f"{kind}/cup?key=rce_bob")
    assert [each["description"] for each in found[listed]] == [BED] * 3
    assert (await call(service, "PUT", f"{kind}/cup.blue/rce_bob/10"))["rating"] == pytest.approx(1.9)
    await call(service, "PUT", f"{kind}/cup.blue/rce_bob/11", 400)
    await call(service, "DELETE", f"{kind}/cup.blue/rce_bob", 403)
    await call(service, "DELETE", f"{kind}/cup.blue/{KEY}", 204)
    await call(service, "GET", f"{kind}/cup?key=rce_bob", 410)


async def test_search_has_a_bound(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(original, "MAX_FOUND", 1)
    for id in ("blue", "red"):
        await add(service, "object", "object_description", id=id)
    (found,) = await call(service, "GET", "object/cup?key=rce_bob")
    assert found["id"] == "cup.blue"


async def test_bad_and_missing_values_are_refused(service: Service) -> None:
    await add(service, "object", "object_description")
    await add(service, "object", "object_description", 409)
    await add(service, "object", "recipe", 400)
    await add(service, "object", "object_description", 401, api_key="wrong")
    await add(service, "object", "object_description", 403, api_key="rce_eve")
    await call(
        service, "POST", "object", 400, json={"api_key": KEY, "id": "a", "class": "b/c", "object_description": ""}
    )
    await call(service, "GET", "object/cup", 401)
    await call(service, "GET", "robot/cup?key=rce_bob", 404)


async def test_files_come_as_forms(service: Service) -> None:
    await add(service, "object", "object_description")
    form = aiohttp.FormData()
    form.add_field("api_key", KEY)
    form.add_field("type", "model")
    form.add_field("file", b"a model", filename="cup.stl", content_type="application/octet-stream")
    record = await call(service, "POST", "binary/objects/cup.blue", data=form)
    url = record["files"]["cup.stl"]["url"]
    assert await (await service.request("GET", url)).read() == b"a model"
    await call(service, "DELETE", f"object/cup.blue/{KEY}/cup.stl", 204)
    assert (await service.request("GET", url)).status == 404
    empty = aiohttp.FormData({"api_key": KEY}, default_to_multipart=True)
    await call(service, "POST", "binary/objects/cup.blue", 400, data=empty)


async def test_queries_are_answered(service: Service) -> None:
    await add(service, "object", "object_description")
    query = (
        "SELECT source FROM CONTEXT source {S} rdf:type {k:Cup} USING NAMESPACE k = <http://example.org/kitchen.owl#>"
    )
    for path in ("serql", "object"):
        found = await call(service, "POST", path, json={"api_key": "rce_eve", "query": query, "repository": "elements"})
        assert found["rows"] == [["<https://rce.invalid/knowledge/object/cup.blue>"]]


async def test_changes_are_audited_without_keys(service: Service) -> None:
    await add(service, "object", "object_description")
    await call(service, "DELETE", f"object/cup.blue/{KEY}", 204)
    recorded = service.master.recorded()
    assert [action for action, _, _ in recorded] == ["knowledge.add", "knowledge.remove"]
    assert not any(KEY in thing for _, thing, _ in recorded)


async def test_key_in_a_path_is_not_logged_with_a_defect(
    service: Service, monkeypatch: pytest.MonkeyPatch, failures: list[LogEvent]
) -> None:
    async def broken(*_: object) -> None:
        raise KeyError("a defect")

    monkeypatch.setattr(service.service.repository, "remove", broken)
    await call(service, "DELETE", f"object/cup.blue/{KEY}", 500)
    (event,) = failures
    assert event["where"].startswith("DELETE /api/0.1/")
    assert KEY not in event["where"]


@pytest.mark.parametrize(
    ("headers", "body"),
    [
        ({"Content-Type": "multipart/form-data; boundary=x"}, b"no boundary"),
        ({"Content-Type": "multipart/form-data; boundary=x"}, b"--x\r\nContent-Disposition: form-data; name=api_key"),
        ({"Content-Type": "multipart/form-data; boundary=x"}, b"--x\r\n\xe8ontent: a\r\n\r\na\r\n--x--\r\n"),
        ({"Content-Type": "multipart/form-data"}, b"--x"),
        ({"Content-Type": "text/plain"}, b"--x"),
        ({}, b""),
    ],
)
async def test_body_that_is_no_form_is_refused(service: Service, headers: dict[str, str], body: bytes) -> None:
    url = f"{service.root}/api/0.1/binary/objects/cup.blue"
    answer = await service.request("POST", url, headers=headers, data=body)
    assert answer.status in (400, 415), await answer.text()
