"""Requests of the client for packages; tests/master/api has it at a real Master."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, cast
from urllib.parse import parse_qs, urlsplit

import msgspec
import pytest

from rce.api.http import EntryClient
from rce.errors import InvalidRequest, LimitExceeded
from rce.packages import archive
from rce.packages.archive import Entry
from rce.packages.client import PAGE_SIZE, Package, PackagesClient, Version


class FakeEntry:
    """Entry of a platform with some packages, which wants uploads at `upload`; it keeps what it gets."""

    def __init__(self) -> None:
        self.packages: list[Package] = []
        self.upload = "/upload/1"
        self.requests: list[tuple[str, str, Any]] = []
        self.uploads: list[tuple[str, bytes, dict[str, str]]] = []
        self.refusal: Exception | None = None

    def json(self, method: str, path: str, body: msgspec.Struct | None = None) -> bytes:
        self.requests.append((method, path, msgspec.to_builtins(body)))
        if self.refusal is not None:
            raise self.refusal
        if method == "GET":
            query = parse_qs(urlsplit(path).query, keep_blank_values=True)
            start, size = int(query["after"][0] or 0), int(query["limit"][0])
            page = self.packages[start : start + size]
            after = str(start + size) if start + size < len(self.packages) else ""
            return msgspec.json.encode({"items": page, "next": after})
        return msgspec.json.encode({"upload": self.upload, "token": "ticket"})

    @contextmanager
    def open(self, method: str, path: str, body: BinaryIO, **headers: str) -> Iterator[io.BytesIO]:
        self.uploads.append((f"{method} {path}", body.read(), headers))
        yield io.BytesIO()


@pytest.fixture
def entry() -> FakeEntry:
    return FakeEntry()


@pytest.fixture
def client(entry: FakeEntry) -> PackagesClient:
    return PackagesClient(cast(EntryClient, entry))


@pytest.fixture
def files(tmp_path: Path) -> list[Entry]:
    source = tmp_path / "source"
    source.write_bytes(b"content")
    return [Entry("talker/package.xml", source, False), Entry("talker/talk.py", source, True)]


def test_list_has_the_packages_of_all_pages(client: PackagesClient, entry: FakeEntry) -> None:
    version = Version("ab" * 32, 5, ["talker"], 1.5)
    entry.packages = [Package(f"ann/p{number}", [version], ["*"]) for number in range(PAGE_SIZE + 1)]
    assert client.list() == entry.packages
    assert len(entry.requests) == 2
    entry.packages = []
    assert client.list() == []


def test_push_announces_the_archive_and_uploads_it(
    client: PackagesClient, entry: FakeEntry, files: list[Entry]
) -> None:
    contents = client.push("demo", files)
    assert contents.packages == ["talker"]
    announced = {"name": "demo", "digest": contents.digest, "size": contents.size}
    assert entry.requests == [("POST", "/api/v1/packages", announced)]
    ((request, body, headers),) = entry.uploads
    assert request == "PUT /upload/1"
    assert archive.inspect(io.BytesIO(body)) == contents
    assert headers == {
        "Authorization": "Bearer ticket",
        "Content-Type": "application/x-tar",
        "Content-Length": str(len(body)),
    }


def test_content_that_the_platform_has_is_not_uploaded(
    client: PackagesClient, entry: FakeEntry, files: list[Entry]
) -> None:
    entry.upload = ""
    first = client.push("demo", files)
    assert client.push("demo", files[::-1]) == first, "the order of the files makes no difference"
    assert entry.uploads == []


def test_files_without_a_ros_package_are_not_announced(
    client: PackagesClient, entry: FakeEntry, files: list[Entry]
) -> None:
    with pytest.raises(InvalidRequest):
        client.push("demo", files[1:])
    assert entry.requests == []


def test_refused_package_is_not_uploaded(client: PackagesClient, entry: FakeEntry, files: list[Entry]) -> None:
    entry.refusal = LimitExceeded("no room")
    with pytest.raises(LimitExceeded, match="no room"):
        client.push("demo", files)
    assert entry.uploads == []


def test_names_are_quoted_in_paths(client: PackagesClient, entry: FakeEntry) -> None:
    client.share("a/b", ["bob", "*"])
    client.unshare("a/b", ["bob", "*"])
    client.unshare("demo", [])
    client.remove("demo")
    client.remove("a b", "1/2")
    assert entry.requests == [
        ("POST", "/api/v1/packages/a%2Fb/shares", {"users": ["bob", "*"]}),
        ("DELETE", "/api/v1/packages/a%2Fb/shares/bob", None),
        ("DELETE", "/api/v1/packages/a%2Fb/shares/%2A", None),
        ("DELETE", "/api/v1/packages/demo/shares", None),
        ("DELETE", "/api/v1/packages/demo", None),
        ("DELETE", "/api/v1/packages/a%20b/versions/1%2F2", None),
    ]
