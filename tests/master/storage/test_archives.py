"""Archives in PostgreSQL: what one Master stored, another one gives to task sets."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from master.storage import archives as archives_module
from master.storage.archives import Archives
from master.storage.depot import AnnouncedUpload, Depot
from master.storage.store import Store
from rce.errors import NotFound
from tests.support.master.postgresql import needs_postgres

pytestmark = [needs_postgres, pytest.mark.parametrize("url", ["postgresql"], indirect=True)]
CONTENT = b"some parts " * 1000
DIGEST = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
async def archives(url: str, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Archives]:
    monkeypatch.setattr(archives_module, "PART", 1000)
    store = Store(url)
    await store.open()
    yield Archives(store)
    await store.close()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    file = tmp_path / "file"
    file.write_bytes(CONTENT)
    return file


async def test_archive_is_read_as_it_was_stored(archives: Archives, file: Path, tmp_path: Path) -> None:
    await archives.put(DIGEST, file)
    await archives.put(DIGEST, file)  # another upload of it
    assert await archives.digests() == {DIGEST}
    await archives.fetch(DIGEST, tmp_path / "back")
    assert (tmp_path / "back").read_bytes() == CONTENT


async def test_missing_and_incomplete_archives_are_not_found(archives: Archives, file: Path, tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        await archives.fetch(DIGEST, tmp_path / "back")
    file.write_bytes(CONTENT[:5000])  # noqa: ASYNC240
    await archives.put(DIGEST, file)
    with pytest.raises(NotFound):
        await archives.fetch(DIGEST, tmp_path / "back")
    assert not (tmp_path / "back").exists()


async def test_archives_that_nothing_names_are_removed(archives: Archives, file: Path) -> None:
    await archives.put(DIGEST, file)
    await archives.keep_only({DIGEST})
    assert await archives.digests() == {DIGEST}
    await archives.keep_only(set())
    assert await archives.digests() == set()


async def test_another_master_has_the_upload(archives: Archives, tmp_path: Path) -> None:
    first, second = Depot(tmp_path / "1", archives), Depot(tmp_path / "2", archives)
    upload = first.begin(first.announce(AnnouncedUpload("ann", "tool", DIGEST, len(CONTENT))), len(CONTENT))
    assert upload is not None
    upload.write(CONTENT)
    upload._file.close()
    await first.store(upload)
    await first.sweep_database(set())  # it is under way, and not named yet
    first.keep(upload)
    upload.close()
    await second.provide(DIGEST)
    await second.provide(DIGEST)
    token, size = second.ticket(DIGEST)
    path = second.fetch(token)
    assert path is not None
    assert (size, path.read_bytes()) == (len(CONTENT), CONTENT)
    await second.sweep_database(set())
    with pytest.raises(NotFound):
        await Depot(tmp_path / "3", archives).provide(DIGEST)


async def test_archives_of_a_master_that_was_alone_are_stored(archives: Archives, file: Path, tmp_path: Path) -> None:
    depot = Depot(tmp_path / "1", archives)
    (tmp_path / "1" / DIGEST).write_bytes(CONTENT)
    await depot.adopt({DIGEST, "0" * 64})
    assert await archives.digests() == {DIGEST}
