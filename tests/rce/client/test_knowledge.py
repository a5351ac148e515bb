"""The client of the knowledge service, with a service in this process."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from rce.api.knowledge import Change, EntryChange, Location
from rce.client.knowledge import KnowledgeClient
from rce.errors import AlreadyExists, InvalidRequest, NotFound, Unavailable
from tests.support.knowledge import BED, CUP, Service, new_entry


@pytest.fixture
async def service(tmp_path: Path) -> AsyncIterator[Service]:
    async with Service(tmp_path / "knowledge") as service:
        yield service


@pytest.fixture
def client(service: Service) -> KnowledgeClient:
    return KnowledgeClient(service.root, key="rce_ann")


async def test_entry_with_versions_and_files(client: KnowledgeClient, tmp_path: Path) -> None:
    def use() -> None:
        entry = client.add(new_entry(location=Location(1, 2), shared=["bob"]))
        assert client.get("object", "cup.blue") == entry
        with pytest.raises(AlreadyExists):
            client.add(new_entry())
        model = tmp_path / "model.stl"
        model.write_bytes(bytes(100_000))
        client.put_file("object", "cup.blue", model)
        client.change("object", "cup.blue", EntryChange(owl=BED))
        assert [each.number for each in client.versions("object", "cup.blue")] == [3, 2, 1]
        assert (client.owl("object", "cup.blue"), client.owl("object", "cup.blue", 1)) == (BED, CUP)
        client.fetch_file("object", "cup.blue", "model.stl", tmp_path / "copy")
        assert (tmp_path / "copy").read_bytes() == bytes(100_000)
        assert client.remove_file("object", "cup.blue", "model.stl").files == []
        with pytest.raises(NotFound):
            client.fetch_file("object", "cup.blue", "model.stl", tmp_path / "none")
        client.fetch_file("object", "cup.blue", "model.stl", tmp_path / "old", 2)
        assert client.rate("object", "cup.blue", 10).rating == pytest.approx(1.9)
        client.remove_version("object", "cup.blue", 1)
        assert client.usage().entries == 1
        client.remove("object", "cup.blue")
        assert list(client.search()) == []

    await asyncio.to_thread(use)


async def test_search_query_and_archive(client: KnowledgeClient, tmp_path: Path) -> None:
    def use() -> None:
        client.add(new_entry(location=Location(1, 2)))
        client.add(new_entry(id="red", owl=""))
        found = client.search(cls="Vessel", text="blue", kind="object", place=(1.001, 2), radius=500)
        assert [each.uid for each in found] == ["cup.blue"]
        assert len(client.query("SELECT ?s { ?s a ?c }").rows) == 1
        with pytest.raises(InvalidRequest, match="SERVICE"):
            client.query("SELECT * { SERVICE <http://127.0.0.1/> { ?s ?p ?o } }")
        client.export(tmp_path / "all.zip")
        client.remove("object", "cup.red")
        result = client.restore(tmp_path / "all.zip")
        assert (result.added, result.skipped) == (1, ["object/cup.blue"])

    await asyncio.to_thread(use)


async def test_changes_come_as_they_happen(client: KnowledgeClient, service: Service) -> None:
    def first(changes: Iterator[Change]) -> Change:
        return next(changes)

    await service.add()
    changes = client.changes(prefix="cup", after=0)
    assert (await asyncio.to_thread(first, changes)).action == "added"
    waiting = asyncio.create_task(asyncio.to_thread(first, changes))
    await service.json("PATCH", "/entries/object/cup.blue", json={"description": "new"})
    assert (await waiting).action == "changed"
    await asyncio.to_thread(changes.close)  # type: ignore[attr-defined]


def test_service_that_cannot_be_reached_is_named() -> None:
    with pytest.raises(Unavailable, match="cannot reach"):
        KnowledgeClient("http://127.0.0.1:1/", key="rce_ann").usage()
    with pytest.raises(InvalidRequest):
        KnowledgeClient("ftp://a", key="rce_ann")


@pytest.mark.parametrize("head", [b"Content-Length: 10\r\n\r\n", b"Transfer-Encoding: chunked\r\n\r\na\r\n"])
async def test_download_that_is_cut_off_leaves_no_file(tmp_path: Path, head: bytes) -> None:
    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        request = await reader.readuntil(b"\r\n\r\n")
        found = b"Content-Length: 0\r\n\r\n" if b"/knowledge-service/ " in request else head + b"abc"
        writer.write(b"HTTP/1.1 200 OK\r\n" + found)
        await writer.drain()
        writer.close()

    async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        client = KnowledgeClient(f"http://127.0.0.1:{port}", key="rce_ann")
        with pytest.raises(Unavailable):
            await asyncio.to_thread(client.fetch_file, "object", "cup.blue", "a", tmp_path / "a")
    assert await asyncio.to_thread(os.listdir, tmp_path) == []
