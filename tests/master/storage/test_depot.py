"""Depot: uploads that were announced become archives, others leave nothing; archives are fetched by tickets."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import pytest

from master.storage.depot import FETCH_SECONDS, UPLOAD_SECONDS, UPLOADS_AT_ONCE, AnnouncedUpload, Depot, Upload
from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.packages import archive


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    return tmp_path / "depot"


@pytest.fixture
def depot(directory: Path) -> Depot:
    return Depot(directory)


@pytest.fixture
def packed(tmp_path: Path) -> bytes:
    """An archive of one package."""
    (tmp_path / "source").write_bytes(b"<package/>")
    file = io.BytesIO()
    archive.write([archive.Entry("p/package.xml", tmp_path / "source", False)], file)
    return file.getvalue()


def announced(content: bytes, user: str = "ann") -> AnnouncedUpload:
    return AnnouncedUpload(user, "tool", hashlib.sha256(content).hexdigest(), len(content))


def begin(depot: Depot, content: bytes) -> Upload:
    upload = depot.begin(depot.announce(announced(content)), len(content))
    assert upload is not None
    return upload


def stored(directory: Path) -> set[str]:
    return {path.name for path in directory.rglob("*") if path.is_file()}


# --- uploads ----------------------------------------------------------------------------------------------------------


async def test_announced_upload_becomes_a_private_archive(depot: Depot, directory: Path, packed: bytes) -> None:
    upload = begin(depot, packed)
    for start in range(0, len(packed), 1000):
        upload.write(packed[start : start + 1000])
    contents = await upload.check()
    assert (contents.packages, contents.size) == (["p"], len(packed))
    depot.keep(upload)
    upload.close()
    file = directory / announced(packed).digest
    assert (file.read_bytes(), file.stat().st_mode & 0o777) == (packed, 0o400)
    assert stored(directory) == {file.name}


async def test_upload_with_another_digest_is_refused_and_leaves_nothing(
    depot: Depot, directory: Path, packed: bytes
) -> None:
    upload = begin(depot, packed)
    upload.write(packed[:-1] + b"x")
    with pytest.raises(InvalidRequest, match="does not have the SHA-256"):
        await upload.check()
    upload.close()
    assert stored(directory) == set()


async def test_upload_that_is_no_archive_is_refused(depot: Depot) -> None:
    upload = begin(depot, b"no archive")
    upload.write(b"no archive")
    with pytest.raises(InvalidRequest):
        await upload.check()
    upload.close()


def test_upload_that_the_disk_has_no_room_for_leaves_nothing(depot: Depot, directory: Path) -> None:
    """Raise at close, when the file still buffers data that could not be written."""
    upload = begin(depot, b"12345")
    upload._file.close()
    upload._file = Path("/dev/full").open("wb")  # noqa: SIM115  # closed by the upload
    upload.write(b"12345")
    upload.close()
    assert stored(directory) == set()
    assert depot.pending() == []


@pytest.mark.parametrize("length", [4, 6, None])
def test_ticket_is_for_one_upload_of_its_size(depot: Depot, directory: Path, length: int | None) -> None:
    token = depot.announce(announced(b"12345"))
    assert depot.begin(token, length) is None
    assert depot.begin(token, 5) is None  # it was used
    assert stored(directory) == set()


def test_ticket_of_an_upload_expires(depot: Depot, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch)
    token, late = depot.announce(announced(b"a")), depot.announce(announced(b"b"))
    clock.now += UPLOAD_SECONDS - 1
    upload = depot.begin(token, 1)
    assert upload is not None
    upload.close()
    clock.now += 2
    assert depot.begin(late, 1) is None
    assert depot.pending() == []


@pytest.mark.parametrize("digest", ["", "0" * 63, "A" * 64, "../" + "0" * 61, "0" * 64 + "\n"])
def test_malformed_digest_is_refused(depot: Depot, digest: str) -> None:
    with pytest.raises(InvalidRequest) as raised:
        depot.announce(AnnouncedUpload("ann", "tool", digest, 1))
    assert raised.value.field == "digest"


@pytest.mark.parametrize("size", [-1, 0, archive.MAX_BYTES + 1])
def test_impossible_size_is_refused(depot: Depot, size: int) -> None:
    with pytest.raises(LimitExceeded) as raised:
        depot.announce(AnnouncedUpload("ann", "tool", "0" * 64, size))
    assert (raised.value.field, raised.value.info.fields) == ("size", {"limit": archive.MAX_BYTES})


def test_number_of_uploads_of_one_user_is_limited(depot: Depot) -> None:
    tokens = [depot.announce(announced(bytes([number]))) for number in range(UPLOADS_AT_ONCE)]
    running = depot.begin(tokens[0], 1)
    assert running is not None
    with pytest.raises(LimitExceeded, match="under way or announced"):
        depot.announce(announced(b"more"))
    depot.announce(announced(b"more", "bob"))
    assert [each.user for each in depot.pending()].count("ann") == UPLOADS_AT_ONCE
    running.close()
    depot.announce(announced(b"more"))


def test_unfinished_uploads_of_an_earlier_life_are_removed(depot: Depot, directory: Path) -> None:
    upload = begin(depot, b"12345")
    upload.write(b"123")
    (directory / ("0" * 64)).touch()
    Depot(directory)
    assert stored(directory) == {"0" * 64}
    upload.close()


# --- archives ---------------------------------------------------------------------------------------------------------


class Clock:
    """Time of the tickets, turned by hand."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 0.0
        monkeypatch.setattr("master.access.tickets.time.monotonic", lambda: self.now)


def test_ticket_fetches_an_archive_once(depot: Depot, directory: Path) -> None:
    (directory / ("0" * 64)).write_bytes(b"12345")
    token, size = depot.ticket("0" * 64)
    assert (depot.fetch(token), size) == (directory / ("0" * 64), 5)
    assert depot.fetch(token) is None


def test_ticket_of_an_archive_expires(depot: Depot, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (directory / ("0" * 64)).touch()
    clock = Clock(monkeypatch)
    token, _ = depot.ticket("0" * 64)
    clock.now += FETCH_SECONDS + 1
    assert depot.fetch(token) is None


@pytest.mark.parametrize("digest", ["1" * 64, "incoming", "../secret", ""])
def test_archive_that_does_not_exist_is_not_found(depot: Depot, directory: Path, digest: str) -> None:
    (directory.parent / "secret").touch()
    with pytest.raises(NotFound):
        depot.ticket(digest)


def test_sweep_removes_archives_that_are_not_named_and_nothing_else(depot: Depot, directory: Path) -> None:
    kept, unused = "0" * 64, "1" * 64
    for name in (kept, unused, "notes.txt"):
        (directory / name).touch()
    upload = begin(depot, b"12345")
    depot.sweep({kept, "2" * 64})
    assert stored(directory) == {kept, "notes.txt", upload.path.name}
    upload.close()
