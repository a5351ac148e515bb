"""Export and import of the repository."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

import pytest

from rce.errors import LimitExceeded
from rce.knowledge import packed
from rce.knowledge.archive import Archive
from rce.knowledge.messages import Document, Reading
from rce.knowledge.records import Reader
from tests.support.knowledge import BED, CUP, Service, SharedWorker, ontologies


@pytest.fixture
async def other(tmp_path: Path, worker: SharedWorker) -> Service:
    """Another service, with nothing in it."""
    return Service(tmp_path / "other", worker=worker)


@pytest.mark.slow
async def test_all_ontologies_come_back_unchanged_from_another_repository(service: Service, other: Service) -> None:
    originals = {f"ontology.{file.stem.lower()}": file.read_bytes() for file in ontologies().glob("*.owl")}
    for file in sorted(ontologies().glob("*.owl")):
        body = {"kind": "object", "class": "ontology", "id": file.stem, "owl": file.read_text()}
        answer = await service.request("POST", "/entries", json=body)
        assert answer.status == (400 if file.stem == "cabinet_model" else 201), await answer.text()
    await service.json("PATCH", "/entries/object/ontology.amigo", json={"description": "a robot", "shared": ["bob"]})
    await service.json("PUT", "/entries/object/ontology.amigo/files/a.stl", data=b"a model")
    archive = await (await service.request("GET", "/archive", "root")).read()
    await other.start()
    try:
        assert await other.json("POST", "/archive", "root", data=archive) == {"added": 13, "skipped": []}
        before, after = [(await each.json("GET", "/entries", "root"))["items"] for each in (service, other)]
        assert after == before
        for entry in after:
            path = f"/entries/object/{entry['uid']}"
            assert await other.json("GET", f"{path}/versions") == await service.json("GET", f"{path}/versions")
            texts = [await (await each.request("GET", f"{path}/owl")).read() for each in (service, other)]
            assert texts[0] == texts[1] == originals[entry["uid"]]
        assert (
            await (await other.request("GET", "/entries/object/ontology.amigo/files/a.stl", "bob")).read() == b"a model"
        )
        found = (await other.json("GET", "/entries?class=SemanticEnvironmentMap"))["items"]
        assert {"ontology.environment_map", "ontology.roboearth"} <= {entry["uid"] for entry in found}
    finally:
        await other.stop()


async def test_export_has_what_its_user_may_read(service: Service) -> None:
    await service.add()
    await service.add("bob", id="hers")
    await service.add("bob", id="open", public=True, shared=["eve"])
    content = await (await service.request("GET", "/archive")).read()
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        names = [name for name in archive.namelist() if name.startswith("entries/")]
        assert sorted(names) == ["entries/object/cup.blue.json", "entries/object/cup.open.json"]
        assert b"eve" not in archive.read("entries/object/cup.open.json")


async def test_imported_entries_are_those_of_who_imports_them(service: Service) -> None:
    await service.add(public=True)
    await service.json("POST", "/entries/object/cup.blue/rating", "bob", json={"rating": 10})
    content = await (await service.request("GET", "/archive")).read()
    assert (await service.json("POST", "/archive", "bob", data=content))["skipped"] == ["object/cup.blue"]
    await service.request("DELETE", "/entries/object/cup.blue")
    assert (await service.json("POST", "/archive", "bob", data=content))["added"] == 1
    entry = await service.json("GET", "/entries/object/cup.blue", "bob")
    assert (entry["author"], entry["rating"], entry["modified_by"]) == ("bob", 1.0, "bob")


def changed(content: bytes, old: bytes, new: bytes) -> bytes:
    """Return an archive in which a text is replaced in all files."""
    result = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as source, zipfile.ZipFile(result, "w") as target:
        for name in source.namelist():
            target.writestr(name, source.read(name).replace(old, new))
    return result.getvalue()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"format":1', b'"format":2'),
        (b"cup.blue", b"../blue"),
        (b"a.stl", b"../../x"),
        (b"the model", b"another!!"),
        (b"bed1", b"bed2"),
        (b'"versions":[', b'"versions":7,"x":['),
        (b'"kind":"object"', b'"kind":"robot"'),
        (b'"time":', b'"time":1e300,"x":'),
        (b'"created":', b'"created":-1,"x":'),
    ],
)
async def test_damaged_archive_is_refused_as_a_whole(service: Service, old: bytes, new: bytes) -> None:
    await service.add(owl=BED)
    await service.json("PUT", "/entries/object/cup.blue/files/a.stl", data=b"the model")
    content = await (await service.request("GET", "/archive")).read()
    await service.request("DELETE", "/entries/object/cup.blue")
    answer = await service.request("POST", "/archive", data=changed(content, old, new))
    assert answer.status == 400, await answer.text()
    assert (await service.json("GET", "/entries"))["items"] == []
    assert not [each for each in (service.directory / "files").glob("*/*") if each.is_file()]


async def test_what_is_no_archive_is_refused(service: Service) -> None:
    assert (await service.request("POST", "/archive", data=b"PK nothing")).status == 400


async def test_export_leaves_nothing_behind(service: Service) -> None:
    await service.add()
    await service.request("GET", "/archive")
    assert [*(service.directory / "files" / "drafts").iterdir()] == []


async def exported(service: Service) -> bytes:
    """Return an archive with one entry that has a file, which is removed then."""
    await service.add(owl=BED)
    await service.json("PUT", "/entries/object/cup.blue/files/a.stl", data=b"the model" * 100)
    content = await (await service.request("GET", "/archive")).read()
    await service.request("DELETE", "/entries/object/cup.blue")
    return content


async def test_archive_with_damaged_data_or_of_another_compression_is_refused(service: Service) -> None:
    content = await exported(service)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        name = next(each for each in archive.namelist() if each.startswith("files/"))
        start = archive.getinfo(name).header_offset + 30 + len(name)
    other = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as source, zipfile.ZipFile(other, "w", zipfile.ZIP_BZIP2) as target:
        for name in source.namelist():
            target.writestr(name, source.read(name))
    for bad in (content[:start] + b"\xff" * 8 + content[start + 8 :], other.getvalue()):
        answer = await service.request("POST", "/archive", data=bad)
        assert answer.status == 400, await answer.text()


async def test_two_files_of_one_name_are_refused(service: Service) -> None:
    content = await exported(service)
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        record = archive.read("entries/object/cup.blue.json")
    file = record[record.rindex(b'{"name"') : record.rindex(b"}]}") + 1]
    answer = await service.request("POST", "/archive", data=changed(content, file + b"]", file + b"," + file + b"]"))
    assert answer.status == 400, await answer.text()


async def test_texts_are_read_a_few_at_a_time(service: Service, monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(3):
        await service.add(id=f"n{number}", owl=f"{CUP}# {number}")
    content = await (await service.request("GET", "/archive")).read()
    for number in range(3):
        await service.request("DELETE", f"/entries/object/cup.n{number}")
    monkeypatch.setattr(packed, "READ_TOGETHER", 1)
    texts = service.service.repository.texts
    read_all, sizes = texts.read_all, list[int]()

    async def counted(user: str, documents: Sequence[Document]) -> list[Reading]:
        sizes.append(len(documents))
        return await read_all(user, documents)

    monkeypatch.setattr(texts, "read_all", counted)
    assert (await service.json("POST", "/archive", data=content))["added"] == 3
    assert sizes == [1, 1, 1]
    assert await (await service.request("GET", "/entries/object/cup.n2/owl")).text() == f"{CUP}# 2"


async def test_reader_has_one_export_at_a_time_and_none_on_a_full_disk(
    service: Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    await service.add()
    archive = Archive(service.service.repository)
    async with archive.export(Reader("ann")):
        with pytest.raises(LimitExceeded, match="in progress"):
            async with archive.export(Reader("ann")):
                pass
        async with archive.export(Reader("bob")):
            pass
    monkeypatch.setattr(service.service.repository.contents, "_spare", 2**60)
    assert (await service.request("GET", "/archive")).status == 503
    monkeypatch.undo()
    assert (await service.request("GET", "/archive")).status == 200


@pytest.mark.parametrize(
    ("offset", "value"),
    [(6, 64), (8, 32), (46, 255)],  # version needed, patched data, place of the member
)
async def test_archive_with_a_damaged_directory_is_refused(service: Service, offset: int, value: int) -> None:
    content = bytearray(await exported(service))
    directory = content.index(b"PK\1\2")
    content[directory + (offset if offset < 46 else 45)] = value
    answer = await service.request("POST", "/archive", data=bytes(content))
    assert answer.status == 400, await answer.text()
