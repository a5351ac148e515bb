"""Store of recordings: quotas, states, uploads, and what a killed task set leaves."""

from __future__ import annotations

import shutil
import threading
import time
from pathlib import Path

import pytest

from containers.recordings import store as module
from containers.recordings.store import MAGIC, OffsetMismatch, RecordingStore
from rce.control.calls.recordings import RecordingQuota
from rce.errors import DiskFull, InvalidRequest, LimitExceeded, NotFound

ANY = RecordingQuota()
WHOLE = MAGIC + b"content" + MAGIC


@pytest.fixture
def store(tmp_path: Path) -> RecordingStore:
    return RecordingStore(tmp_path, now=lambda: 0.0)


def record(store: RecordingStore, content: bytes, quota: RecordingQuota = ANY) -> str:
    recording = store.begin("ann/brain", "box", quota)
    recording.write(content)
    recording.end()
    return recording.id


def test_recording_is_kept_and_read_by_its_user_alone(store: RecordingStore) -> None:
    id = record(store, WHOLE)
    (found,) = store.of("ann")
    assert (found.name, found.state, found.size) == ("brain-box-19700101-000000.mcap", "complete", len(WHOLE))
    assert (found.environment, found.recorder) == ("brain", "box")
    assert store.read("ann", id, 8, 7) == b"content"
    assert store.read("ann", id, 1000, 7) == b""
    assert store.of("bob") == []
    for use in (lambda: store.read("bob", id, 0, 1), lambda: store.remove("bob", id)):
        with pytest.raises(NotFound):
            use()
    store.remove("ann", id)
    assert store.of("ann") == []


@pytest.mark.parametrize("content", [b"", MAGIC, MAGIC + b"content"])
def test_recording_without_an_end_is_cut_off(store: RecordingStore, content: bytes) -> None:
    record(store, content)
    assert [each.state for each in store.of("ann")] == ["cut off"]


def test_what_a_killed_task_set_was_writing_is_cut_off_at_the_next_start(tmp_path: Path) -> None:
    earlier = RecordingStore(tmp_path)
    whole = record(earlier, WHOLE)
    earlier.begin("ann/brain", "box", ANY).write(MAGIC + b"half")
    removed = record(earlier, WHOLE)
    earlier.path(removed).unlink()  # it was being removed
    later = RecordingStore(tmp_path)
    assert {each.id == whole: (each.state, each.size) for each in later.of("ann")} == {
        True: ("complete", len(WHOLE)),
        False: ("cut off", len(MAGIC) + 4),
    }


def test_quota_ends_a_recording_and_counts_all_of_a_user(store: RecordingStore) -> None:
    record(store, WHOLE)
    quota = RecordingQuota(len(WHOLE) + 10)
    recording = store.begin("ann/brain", "box", quota)
    recording.write(bytes(10))
    with pytest.raises(LimitExceeded, match="yours may have"):
        recording.write(b"1")
    recording.end()
    with pytest.raises(LimitExceeded):
        store.begin("ann/brain", "box", quota)
    assert store.begin("bob/brain", "box", quota).id
    assert len(store.of("ann")) == 2


def test_disk_that_is_nearly_full_ends_a_recording(store: RecordingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = store.begin("ann/brain", "box", ANY)
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(module.shutil, "disk_usage", lambda _: usage._replace(free=10))
    with pytest.raises(DiskFull):
        recording.write(bytes(100))


def test_number_of_files_is_limited(store: RecordingStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_FILES", 1)
    record(store, WHOLE)
    with pytest.raises(LimitExceeded, match="remove some"):
        store.begin("ann/brain", "box", ANY)


def test_removed_recording_ends(store: RecordingStore) -> None:
    recording = store.begin("ann/brain", "box", ANY)
    store.remove("ann", recording.id)
    with pytest.raises(NotFound, match="was removed"):
        recording.write(b"x")
    recording.end()
    assert store.of("ann") == []


def test_upload_is_appended_until_it_is_complete(store: RecordingStore) -> None:
    upload = store.announce("ann", "drive.mcap", len(WHOLE), "mark", ANY)
    assert (upload.state, upload.size, upload.length, upload.fingerprint) == ("uploading", 0, len(WHOLE), "mark")
    assert store.append("ann", upload.id, 0, WHOLE[:10]).size == 10
    with pytest.raises(OffsetMismatch) as refused:
        store.append("ann", upload.id, 0, WHOLE[:10])
    assert refused.value.info.fields == {"offset": 10}
    assert store.append("ann", upload.id, 10, WHOLE[10:]).state == "complete"
    assert store.read("ann", upload.id, 0, 100) == WHOLE
    with pytest.raises(OffsetMismatch):
        store.append("ann", upload.id, len(WHOLE), b"more")


@pytest.mark.parametrize("content", [b"#ROSBAG V2.0\n", MAGIC + bytes(100)])
def test_upload_of_something_else_is_removed(store: RecordingStore, content: bytes) -> None:
    upload = store.announce("ann", "drive.mcap", 20, "", ANY)
    with pytest.raises(InvalidRequest):
        store.append("ann", upload.id, 0, content)
    assert store.of("ann") == []


@pytest.mark.parametrize(("name", "length"), [("../a.mcap", 9), ("a.bag", 9), ("a.mcap", 0)])
def test_upload_that_cannot_be_a_recording_is_refused(store: RecordingStore, name: str, length: int) -> None:
    with pytest.raises(InvalidRequest):
        store.announce("ann", name, length, "", ANY)


def test_announced_upload_counts_in_the_quota(store: RecordingStore) -> None:
    store.announce("ann", "a.mcap", 80, "", RecordingQuota(100))
    with pytest.raises(LimitExceeded):
        store.announce("ann", "b.mcap", 80, "", RecordingQuota(100))


def test_recordings_of_a_removed_user_are_removed_and_those_that_go_on_end(store: RecordingStore) -> None:
    record(store, WHOLE)
    going_on = store.begin("ann/brain", "box", ANY)
    kept = store.begin("bob/brain", "box", ANY)
    store.forget("ann")
    assert store.of("ann") == []
    with pytest.raises(NotFound):
        going_on.write(MAGIC)
    kept.write(MAGIC)


def test_upload_to_which_nothing_is_appended_is_removed_after_a_day(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would take the room that it announced from others for ever."""
    usage = shutil.disk_usage(tmp_path)._replace(free=module.SPARE + 1000)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    now = time.time()
    store = RecordingStore(tmp_path, now=lambda: now)
    store.announce("ann", "a.mcap", 900, "", ANY)
    with pytest.raises(DiskFull):
        store.announce("bob", "b.mcap", 900, "", ANY)
    now += module.ABANDONED + 1
    store.announce("bob", "b.mcap", 900, "", ANY)
    assert store.of("ann") == []


def test_recording_is_not_removed_while_it_is_opened_to_be_read(
    store: RecordingStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    id, path = record(store, WHOLE), store.path
    removals: list[threading.Thread] = []

    def path_while_removed(id: str) -> Path:
        found = path(id)
        if not removals:
            removals.append(threading.Thread(target=store.remove, args=("ann", id)))
            removals[0].start()
            removals[0].join(0.05)  # it waits until the file is open
        return found

    monkeypatch.setattr(store, "path", path_while_removed)
    assert store.read("ann", id, 8, 7) == b"content"
    removals[0].join()
    with pytest.raises(NotFound):
        store.read("ann", id, 8, 7)
