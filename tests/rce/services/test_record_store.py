"""Records in files: what survives, and what is removed at the next start."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
from msgspec import Struct

from rce.errors import InvalidRequest
from rce.services.record_store import RECORD, RecordStore, check_file_name, new_id


class Note(Struct, frozen=True):
    text: str


def loaded(directory: Path) -> dict[str, Note]:
    return RecordStore(directory, Note).load()


def test_record_is_loaded_again(tmp_path: Path) -> None:
    store = RecordStore(tmp_path / "new" / "notes", Note)
    store.put("a", Note("one"))
    store.put("b", Note("two"))
    store.put("a", Note("three"))
    assert loaded(tmp_path / "new" / "notes") == {"a": Note("three"), "b": Note("two")}


def test_other_users_of_the_machine_cannot_read_records(tmp_path: Path) -> None:
    store = RecordStore(tmp_path / "notes", Note)
    store.put("a", Note("one"))
    assert (tmp_path / "notes").stat().st_mode & 0o077 == 0
    assert store.path("a").stat().st_mode & 0o077 == 0


def test_failed_write_keeps_the_old_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = RecordStore(tmp_path, Note)
    store.put("a", Note("old"))

    def fail(self: Path, data: bytes) -> int:
        self.touch()  # the disk is full: nothing of the new record is written
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fail)
    with pytest.raises(OSError, match="space"):
        store.put("a", Note("new"))
    assert loaded(tmp_path) == {"a": Note("old")}


def test_directory_without_a_record_is_removed(tmp_path: Path) -> None:
    half = tmp_path / "half"
    half.mkdir()
    (half / f".{RECORD}").write_bytes(b"{}")
    assert loaded(tmp_path) == {}
    assert not half.exists()


@pytest.mark.parametrize("content", [b"", b"\0" * 40, b'{"text": 3}', b"[]", b'{"text": "\xff"}'], ids=ascii)
def test_malformed_record_is_ignored_and_kept(tmp_path: Path, content: bytes) -> None:
    """After a failure of the power a record may have any content; the service starts all the same."""
    RecordStore(tmp_path, Note).put("good", Note("one"))
    path = tmp_path / "bad" / RECORD
    path.parent.mkdir()
    path.write_bytes(content)
    assert loaded(tmp_path) == {"good": Note("one")}
    assert path.read_bytes() == content


@pytest.mark.parametrize("name", ["a", "A-1_b.bag", "x" * 200])
def test_safe_file_name_is_returned(name: str) -> None:
    assert check_file_name(name, "field") == name


@pytest.mark.parametrize(
    "name", ["", ".", "..", ".hidden", "-a", "../a", "a/b", "a\\b", "a\0", "a\n", "ü", "x" * 201, RECORD]
)
def test_unsafe_file_name_is_refused(name: str) -> None:
    with pytest.raises(InvalidRequest, match="not a valid file name") as wrong:
        check_file_name(name, "recording.name")
    assert wrong.value.field == "recording.name"


def test_ids_differ() -> None:
    assert len({new_id() for _ in range(100)}) == 100
