"""Resumable uploads, with a fake clock."""

from __future__ import annotations

import asyncio
import gzip
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from twisted.internet.task import Clock

from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.mapservice.uploads import DAY, OffsetMismatch, UploadLimits, Uploads

BAG = b"#ROSBAG V2.0\n" + bytes(2000)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def uploads(tmp_path: Path, clock: Clock) -> Uploads:
    return make(tmp_path, clock)


def make(directory: Path, clock: Clock, results: int = 0, spare: int = 0) -> Uploads:
    return Uploads(
        directory / "uploads", UploadLimits(10_000_000, 12_000_000, spare, 3 * DAY), lambda _: results, clock.seconds
    )


async def pieces(*parts: bytes, error: BaseException | None = None) -> AsyncIterator[bytes]:
    for part in parts:
        yield part
        await asyncio.sleep(0)
    if error is not None:
        raise error


async def test_interrupted_upload_is_resumed_at_its_offset(uploads: Uploads, tmp_path: Path) -> None:
    upload = uploads.create("ann", "a.bag", len(BAG))
    with pytest.raises(ConnectionResetError):
        await uploads.append("ann", upload.id, 0, pieces(BAG[:5], BAG[5:900], error=ConnectionResetError()))
    assert uploads.get("ann", upload.id).offset == 900
    again = make(tmp_path, Clock())  # after a restart of the service
    assert again.get("ann", upload.id).offset == 900
    with pytest.raises(OffsetMismatch) as wrong:
        await again.append("ann", upload.id, 899, pieces(BAG[899:]))
    assert wrong.value.info.fields["offset"] == 900
    done = await again.append("ann", upload.id, 900, pieces(BAG[900:1000], BAG[1000:]))
    assert (done.offset, done.length) == (len(BAG), len(BAG))
    assert again.path(upload.id).read_bytes() == BAG


async def test_large_chunks_are_written_in_order(uploads: Uploads) -> None:
    content = b"".join(number.to_bytes(4) for number in range(1_200_000))
    name = uploads.create("ann", "a.mcap", len(content) + 8).id
    parts = [b"\x89MCAP0\r\n", *(content[start : start + 777_777] for start in range(0, len(content), 777_777))]
    await uploads.append("ann", name, 0, pieces(*parts))
    assert uploads.path(name).read_bytes() == b"".join(parts)


async def test_new_request_replaces_a_hanging_one(uploads: Uploads) -> None:
    upload = uploads.create("ann", "a.bag", len(BAG))
    arrived = asyncio.Event()

    async def hanging() -> AsyncIterator[bytes]:
        yield BAG[:600]
        arrived.set()
        await asyncio.Event().wait()

    old = asyncio.create_task(uploads.append("ann", upload.id, 0, hanging()))
    await arrived.wait()
    with pytest.raises(OffsetMismatch):  # the data of the hanging request has been written
        await uploads.append("ann", upload.id, 0, pieces(BAG))
    assert old.cancelled()
    assert (await uploads.append("ann", upload.id, 600, pieces(BAG[600:]))).offset == len(BAG)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.bag", b"#ROSRECORD V1.2\n", r"format 1\.2.*rosbag fix"),
        ("a.bag", b"PK\x03\x04", "not a ROS 1 bag"),
        ("a.db3", BAG[:20], "SQLite"),
        ("a.mcap", b"MCAP", "MCAP"),
        ("a.log.gz", b"FLASER 3", "gzip"),
        ("a.log", gzip.compress(b"FLASER", mtime=0), "not text"),
        ("metadata.yaml", b"\0", "not text"),
    ],
)
@pytest.mark.parametrize("size", [64, 5000])
async def test_other_files_are_refused_by_their_first_bytes(
    uploads: Uploads, name: str, content: bytes, reason: str, size: int
) -> None:
    whole = content.ljust(size, b"\0")
    upload = uploads.create("ann", name, size)
    read = []

    async def counted() -> AsyncIterator[bytes]:
        for start in range(0, size, 100):
            read.append(start)
            yield whole[start : start + 100]

    with pytest.raises(InvalidRequest, match=reason):
        await uploads.append("ann", upload.id, 0, counted())
    assert len(read) <= 6, "the rest is not read"
    with pytest.raises(NotFound):
        uploads.get("ann", upload.id)
    assert uploads.used("ann") == 0


@pytest.mark.parametrize(
    "name", ["", "../a.bag", "a/b.bag", ".bag", "a\0.bag", "ü.bag", "x" * 300 + ".bag", "record.json"]
)
def test_unsafe_file_names_are_refused(uploads: Uploads, name: str) -> None:
    with pytest.raises(InvalidRequest) as wrong:
        uploads.create("ann", name, 10)
    assert wrong.value.field == "Upload-Metadata.filename"


@pytest.mark.parametrize("name", ["a.csv", "bag", "a.bag.zip"])
def test_other_suffixes_are_refused(uploads: Uploads, name: str) -> None:
    with pytest.raises(InvalidRequest, match="not a recording by its name"):
        uploads.create("ann", name, 10)


def test_empty_file_is_refused(uploads: Uploads) -> None:
    with pytest.raises(InvalidRequest, match="empty"):
        uploads.create("ann", "a.bag", 0)


async def test_more_data_than_announced_is_refused(uploads: Uploads) -> None:
    upload = uploads.create("ann", "a.bag", 1000)
    with pytest.raises(InvalidRequest, match="more bytes"):
        await uploads.append("ann", upload.id, 0, pieces(BAG))


def test_size_limits(tmp_path: Path, clock: Clock) -> None:
    uploads = make(tmp_path, clock, results=1_000_000)
    with pytest.raises(LimitExceeded, match="a file may have at most 10000000") as wrong:
        uploads.create("ann", "a.bag", 10_000_001)
    assert wrong.value.info.fields == {"limit": 10_000_000, "asked": 10_000_001}
    first = uploads.create("ann", "a.bag", 10_000_000)
    with pytest.raises(LimitExceeded, match="you have 11000000 bytes"):
        uploads.create("ann", "b.bag", 1_000_001)
    uploads.create("ann", "b.bag", 1_000_000)
    uploads.create("bob", "b.bag", 10_000_000)
    assert uploads.used("ann") == 12_000_000
    assert first.offset == 0
    with pytest.raises(LimitExceeded, match=r"disk full \(map service\): there is room for 0 bytes"):
        make(tmp_path, clock, spare=2**60).create("cleo", "a.bag", 1)


def test_number_of_files_is_limited(uploads: Uploads, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rce.mapservice.uploads.MAX_FILES", 2)
    for _ in range(2):
        uploads.create("ann", "a.bag", 1)
    with pytest.raises(LimitExceeded, match="2 files"):
        uploads.create("ann", "a.bag", 1)
    uploads.create("bob", "a.bag", 1)


def test_results_count_towards_the_quota(tmp_path: Path, clock: Clock) -> None:
    make(tmp_path, clock, results=11_999_999).check_quota("ann")
    with pytest.raises(LimitExceeded, match="remove jobs or uploads"):
        make(tmp_path, clock, results=12_000_000).check_quota("ann")


async def test_uploads_belong_to_their_user(uploads: Uploads) -> None:
    upload = uploads.create("ann", "a.bag", len(BAG), "mark")
    with pytest.raises(NotFound):
        uploads.get("bob", upload.id)
    with pytest.raises(NotFound):
        await uploads.append("bob", upload.id, 0, pieces(BAG))
    with pytest.raises(NotFound):
        await uploads.remove("bob", upload.id)
    assert uploads.of("bob") == []
    assert [each.fingerprint for each in uploads.of("ann")] == ["mark"]
    await uploads.remove("ann", upload.id)
    assert uploads.of("ann") == []


async def test_unused_uploads_expire(uploads: Uploads, clock: Clock, tmp_path: Path) -> None:
    unfinished = uploads.create("ann", "a.bag", len(BAG)).id
    finished = uploads.create("ann", "b.bag", len(BAG)).id
    needed = uploads.create("ann", "c.bag", len(BAG)).id
    for name in (finished, needed):
        await uploads.append("ann", name, 0, pieces(BAG))
    clock.advance(DAY + 1)
    await uploads.sweep(lambda _: False)
    assert {each.id for each in uploads.of("ann")} == {finished, needed}
    clock.advance(DAY)
    uploads.touch(finished)
    clock.advance(2 * DAY)
    await uploads.sweep(lambda name: name == needed)
    assert {each.id for each in uploads.of("ann")} == {finished, needed}
    clock.advance(DAY + 1)
    await uploads.sweep(lambda name: name == needed)
    assert {each.id for each in uploads.of("ann")} == {needed}
    assert {path.name for path in (tmp_path / "uploads").iterdir()} == {needed}
    assert unfinished not in {each.id for each in make(tmp_path, clock).of("ann")}


def test_unacknowledged_upload_is_removed_at_the_next_start(tmp_path: Path, clock: Clock) -> None:
    half = tmp_path / "uploads" / "abc"
    half.mkdir(parents=True)
    (half / "a.bag").write_bytes(BAG)
    assert make(tmp_path, clock).of("ann") == []
    assert not half.exists()
