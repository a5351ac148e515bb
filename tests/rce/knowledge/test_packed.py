"""Reading of archives."""

from __future__ import annotations

import hashlib
import io
import zipfile
from pathlib import Path

import pytest

from rce.api.knowledge import MAX_OWL
from rce.errors import InvalidRequest, LimitExceeded
from rce.knowledge import packed
from rce.knowledge.packed import Format, open_member, read_record, read_text, some_texts


def archive(*contents: bytes, compression: int = zipfile.ZIP_DEFLATED) -> tuple[zipfile.ZipFile, list[str]]:
    """Return an archive with texts, and their digests."""
    result, digests = io.BytesIO(), [hashlib.sha256(content).hexdigest() for content in contents]
    with zipfile.ZipFile(result, "w", compression) as target:
        for digest, content in zip(digests, contents, strict=True):
            target.writestr(f"texts/{digest}", content)
    return zipfile.ZipFile(result), digests


@pytest.mark.parametrize("zip64", [False, True])
def test_archive_with_a_large_directory_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, zip64: bool
) -> None:
    path = tmp_path / "a.zip"
    if zip64:
        monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", 1)
    with zipfile.ZipFile(path, "w") as made:
        for number in range(20):
            made.writestr(f"entries/object/{number}.json", "")
        made.comment = b"a comment"
    assert (b"PK\6\6" in path.read_bytes()) == zip64
    with packed.open_archive(path) as opened:
        assert len(opened.namelist()) == 20
    monkeypatch.setattr(packed, "MAX_DIRECTORY", 1000)
    with pytest.raises(LimitExceeded, match=r"directory of the archive has 1\d\d\d bytes"):
        packed.open_archive(path)


def test_large_directory_behind_a_small_one_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The record of ZIP64 is what counts, even if the usual one is complete."""
    path = tmp_path / "a.zip"
    end = packed.END.pack(b"PK\5\6", 0, 0, 1, 1, 46, 0, 0)
    large = packed.END_64.pack(b"PK\6\6", 44, 45, 45, 0, 0, 1, 1, 2**40, 0)
    path.write_bytes(large + packed.LOCATOR.pack(b"PK\6\7", 0, 0, 1) + end)
    with pytest.raises(LimitExceeded):
        packed.open_archive(path)


@pytest.mark.parametrize("content", [b"", b"PK", b"PK\5\6", b"x" * 100_000])
def test_other_file_is_no_archive(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.zip"
    path.write_bytes(content)
    with pytest.raises(zipfile.BadZipFile):
        packed.open_archive(path)


@pytest.mark.parametrize(
    ("content", "reason"), [(b"\xff", "not UTF-8"), (b" " * (MAX_OWL + 1), "characters"), (bytes(5 * MAX_OWL), "bytes")]
)
def test_text_that_no_entry_may_have_is_refused(content: bytes, reason: str) -> None:
    found, (digest,) = archive(content)
    with pytest.raises(InvalidRequest, match=reason):
        read_text(found, digest)


def test_member_that_is_missing_or_compressed_in_another_way_is_refused() -> None:
    found, (digest,) = archive(b"text", compression=zipfile.ZIP_BZIP2)
    with pytest.raises(InvalidRequest, match="compressed"):
        open_member(found, f"texts/{digest}", 100)
    with pytest.raises(InvalidRequest, match="has no format"):
        read_record(found, "format.json", Format)


def test_texts_are_taken_up_to_a_size(monkeypatch: pytest.MonkeyPatch) -> None:
    found, digests = archive(b"one", b"two", b"three")
    monkeypatch.setattr(packed, "READ_TOGETHER", 4)
    entry = packed.ArchivedEntry("object", "a.b", "ann", 0, 1, [])
    wanted = iter([(entry, digest) for digest in digests])
    assert [[text for *_, text in some_texts(found, wanted)] for _ in range(3)] == [["one", "two"], ["three"], []]
