"""REST interface of the knowledge service."""

from __future__ import annotations

import asyncio

import aiohttp
import msgspec
import pytest

from rce.api.knowledge import Change
from tests.support.knowledge import BED, CUP, Service


async def test_added_entry_is_found_and_read(service: Service) -> None:
    answer = await service.request(
        "POST",
        "/entries",
        json={"kind": "object", "class": "Tea Cup", "id": "Blue 1", "owl": CUP, "description": "mine"},
    )
    entry = await answer.json()
    assert (answer.status, entry["uid"], entry["version"], entry["author"]) == (201, "teacup.blue1", 1, "ann")
    assert answer.headers["Location"] == f"{service.url}/entries/object/teacup.blue1"
    assert await service.json("GET", "/entries/object/TeaCup.Blue1") == entry
    owl = await service.request("GET", "/entries/object/teacup.blue1/owl")
    assert (await owl.text(), owl.content_type) == (CUP, "text/turtle")
    assert (await service.json("GET", "/entries?prefix=Tea"))["items"] == [entry]


async def test_each_change_is_a_version_and_all_are_kept(service: Service) -> None:
    await service.add()
    path = "/entries/object/cup.blue"
    for number in range(4):
        await service.json("PATCH", path, json={"description": f"change {number}"})
    await service.json("PATCH", path, json={"owl": BED})
    await service.json("PUT", f"{path}/files/model.bin", data=b"a model")
    versions = await service.json("GET", f"{path}/versions")
    assert [each["number"] for each in versions] == [7, 6, 5, 4, 3, 2, 1]
    assert [file["name"] for file in versions[0]["files"]] == ["model.bin"]
    assert versions[1]["files"] == []
    assert await (await service.request("GET", f"{path}/owl?version=1")).text() == CUP
    assert await (await service.request("GET", f"{path}/owl")).text() == BED
    assert (await service.request("GET", f"{path}/owl?version=99")).status == 404


async def test_rights_do_not_make_a_version(service: Service) -> None:
    await service.add()
    changed = await service.json("PATCH", "/entries/object/cup.blue", json={"public": True, "shared": ["bob"]})
    assert (changed["version"], changed["public"], changed["shared"]) == (1, True, ["bob"])


@pytest.mark.parametrize("fields", [{"public": True}, {"shared": ["bob"]}])
async def test_entry_of_another_user_is_read_if_it_is_public_or_shared(
    service: Service, fields: dict[str, object]
) -> None:
    await service.add()
    path = "/entries/object/cup.blue"
    for hidden in (path, f"{path}/owl", f"{path}/versions", f"{path}/files/a"):
        assert (await service.request("GET", hidden, "bob")).status == 404
    assert (await service.json("GET", "/entries", "bob"))["items"] == []
    await service.json("PATCH", path, json=fields)
    assert (await service.json("GET", path, "bob"))["shared"] == [], "who else may read it is the author's business"
    assert len((await service.json("GET", "/entries", "bob"))["items"]) == 1
    assert (await service.request("PATCH", path, "bob", json={"description": "x"})).status == 403
    assert (await service.request("DELETE", path, "bob")).status == 403
    assert (await service.json("PATCH", path, "root", json={"description": "by the administrator"}))[
        "modified_by"
    ] == "root"


async def test_viewer_reads_and_changes_nothing(service: Service) -> None:
    await service.add(public=True)
    await service.json("GET", "/entries/object/cup.blue", "eve")
    assert (await service.request("POST", "/entries/object/cup.blue/rating", "eve", json={"rating": 3})).status == 403
    assert (await service.request("POST", "/entries", "nobody", json={})).status == 401
    assert (await service.request("GET", "/entries", "")).status == 401


async def test_rating_moves_by_a_tenth_of_the_difference(service: Service) -> None:
    await service.add(public=True)
    rated = await service.json("POST", "/entries/object/cup.blue/rating", "bob", json={"rating": 10})
    assert rated["rating"] == pytest.approx(1.9)
    assert (await service.request("POST", "/entries/object/cup.blue/rating", json={"rating": 11})).status == 400


async def test_uid_exists_once(service: Service) -> None:
    await service.add()
    answer = await service.request("POST", "/entries", "bob", json={"kind": "object", "class": "CUP", "id": "Blue"})
    assert answer.status == 409
    await service.add(kind="recipe")


async def test_broken_text_is_refused_with_line_and_reason(service: Service) -> None:
    answer = await service.request(
        "POST", "/entries", json={"kind": "object", "class": "a", "id": "b", "owl": BED.replace("</rdf:RDF>", "</x>")}
    )
    problem = await answer.json()
    assert answer.status == 400
    assert problem["detail"].startswith("line 5, column")
    assert "mismatched tag" in problem["detail"]
    assert problem["field"] == "owl"
    assert (await service.json("GET", "/entries"))["items"] == []


async def test_file_comes_back_as_it_was_and_stays_in_old_versions(service: Service) -> None:
    await service.add()
    path = "/entries/object/cup.blue/files/model.stl"
    content = bytes(range(256)) * 500
    entry = await service.json("PUT", path, data=content)
    assert entry["files"][0]["size"] == len(content)
    answer = await service.request("GET", path)
    assert (await answer.read(), answer.headers["X-Content-Type-Options"]) == (content, "nosniff")
    assert (await service.json("DELETE", path))["files"] == []
    assert (await service.request("GET", path)).status == 404
    assert await (await service.request("GET", f"{path}?version=2")).read() == content
    assert (await service.request("DELETE", path)).status == 404


@pytest.mark.parametrize("name", ["..%2Fetc", ".hidden", "a%00b", "x" * 201])
async def test_unsafe_file_name_is_refused(service: Service, name: str) -> None:
    await service.add()
    assert (await service.request("PUT", f"/entries/object/cup.blue/files/{name}", data=b"x")).status in (400, 404)


async def test_removed_entry_takes_versions_files_and_quota_with_it(service: Service) -> None:
    await service.add()
    await service.json("PUT", "/entries/object/cup.blue/files/a", data=b"content")
    assert (await service.json("GET", "/usage"))["entries"] == 1
    assert (await service.request("DELETE", "/entries/object/cup.blue")).status == 204
    assert (await service.request("GET", "/entries/object/cup.blue")).status == 404
    assert (await service.json("GET", "/usage"))["bytes"] == 0
    assert not [each for each in (service.directory / "files").glob("??/*") if each.is_file()]
    await service.add()


async def test_quota_covers_all_versions(service: Service) -> None:
    await service.add()
    path = "/entries/object/cup.blue"
    for number in range(2):
        await service.json("PUT", f"{path}/files/a", data=bytes([number]) * 999_000)
    answer = await service.request("PUT", f"{path}/files/a", data=b"c" * 999_000)
    assert (answer.status, (await answer.json())["code"]) == (413, "limit_exceeded")
    assert (await service.json("GET", path))["version"] == 3
    assert (await service.request("DELETE", f"{path}/versions/2")).status == 204
    await service.json("PUT", f"{path}/files/a", data=b"c" * 999_000)
    assert (await service.request("DELETE", f"{path}/versions/4")).status == 400
    assert (await service.request("PUT", f"{path}/files/b", data=b"c" * 1_000_001)).status == 413


async def test_query_sees_what_its_user_may_read(service: Service) -> None:
    await service.add()
    await service.add("bob", id="hers", public=True)
    count = "SELECT (COUNT(DISTINCT ?g) AS ?n) { GRAPH ?g { ?s a ?c } }"
    for user, expected in (("ann", 2), ("bob", 1), ("root", 2), ("eve", 1)):
        rows = (await service.query(count, user))["rows"]
        assert rows == [[f'"{expected}"^^<http://www.w3.org/2001/XMLSchema#integer>']], user
    await service.json("PATCH", "/entries/object/cup.hers", "bob", json={"public": False})
    assert (await service.query(count))["rows"][0][0].startswith('"1"')


async def test_serql_of_original_clients_is_answered(service: Service) -> None:
    await service.add()
    serql = """SELECT source FROM CONTEXT source {S} rdf:type {k:Cup}
        USING NAMESPACE k = <http://example.org/kitchen.owl#>"""
    found = await service.query(serql, language="serql")
    assert found["rows"] == [["<https://rce.invalid/knowledge/object/cup.blue>"]]


async def test_refused_query_leaves_the_service_alive(service: Service) -> None:
    await service.add()
    for query in ("SELECT * { SERVICE <http://127.0.0.1/> { ?s ?p ?o } }", "LOAD <http://127.0.0.1/>", "SELECT"):
        answer = await service.request("POST", "/query", json={"query": query})
        assert (answer.status, (await answer.json())["field"]) == (400, "query")
    assert (await service.query("ASK { ?s a ?c }"))["answer"] is True


async def next_change(lines: aiohttp.StreamReader) -> Change:
    """Return the next change of an event stream."""
    while True:
        line = await asyncio.wait_for(lines.readline(), 30)
        assert line, "the stream has ended"
        if line.startswith(b"data: "):
            return msgspec.json.decode(line[6:], type=Change)


async def test_subscriber_is_told_of_changes_that_fit_and_resumes(service: Service) -> None:
    headers = {"Authorization": "Bearer rce_bob"}
    url = f"{service.url}/changes?class=Thing"
    async with service.session.get(url, headers=headers) as stream:
        assert await stream.content.readline() == b": here\n"
        await service.add(id="private")
        await service.add(kind="environment", owl=BED, public=True, **{"class": "room"})
        await service.add(id="one", public=True)
        first = await next_change(stream.content)
        assert (first.action, first.uid, first.user) == ("added", "cup.one", "ann")
    await service.json("PATCH", "/entries/object/cup.one", json={"description": "changed"})
    assert (await service.request("DELETE", "/entries/object/cup.one")).status == 204
    async with service.session.get(url, headers=headers | {"Last-Event-ID": str(first.number)}) as stream:
        assert [(await next_change(stream.content)).action for _ in range(2)] == ["changed", "removed"]


async def test_changes_are_audited_and_reading_is_not(service: Service) -> None:
    await service.add()
    await service.json("GET", "/entries/object/cup.blue")
    assert (await service.request("DELETE", "/entries/object/cup.blue", "bob")).status == 404
    assert service.master.recorded() == [
        ("knowledge.add", "ann/cup.blue", "ok"),
        ("knowledge.remove", "bob/object/cup.blue", "not_found"),
    ]


async def test_anonymous_clients_read_what_is_public_if_they_may(service: Service) -> None:
    await service.add()
    await service.add(id="open", public=True)
    await service.stop()
    service.anonymous = True
    await service.start()
    assert [each["uid"] for each in (await service.json("GET", "/entries", ""))["items"]] == ["cup.open"]
    assert (await service.request("DELETE", "/entries/object/cup.open", "")).status == 401


async def test_entries_survive_a_restart(service: Service) -> None:
    before = await service.add()
    await service.json("PUT", "/entries/object/cup.blue/files/a", data=b"content")
    await service.stop()
    await service.start()
    assert (await service.json("GET", "/entries/object/cup.blue"))["created"] == before["created"]
    assert await (await service.request("GET", "/entries/object/cup.blue/files/a")).read() == b"content"


async def test_subscriber_that_may_do_less_now_is_told_less(service: Service) -> None:
    async with service.session.get(f"{service.url}/changes", headers={"Authorization": "Bearer rce_root"}) as stream:
        await service.add("bob", id="one")
        assert (await next_change(stream.content)).uid == "cup.one"
        service.master.unbounded.clear()
        service.service.authenticator.invalidate("root")
        await service.add("bob", id="two")
        await service.add("bob", id="three", public=True)
        assert (await next_change(stream.content)).uid == "cup.three"


@pytest.mark.parametrize(("number", "status"), [("0", 400), ("-1", 400), ("9" * 30, 400), ("7", 404)])
async def test_version_that_cannot_exist_is_not_removed(service: Service, number: str, status: int) -> None:
    await service.add()
    assert (await service.request("DELETE", f"/entries/object/cup.blue/versions/{number}")).status == status
    assert (await service.request("GET", "/entries/object/cup.blue/owl?version=0")).status == 404
