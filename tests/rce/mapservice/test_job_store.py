"""Storage of jobs: what is kept on disk, what only in memory, and who is told of changes."""

from __future__ import annotations

import asyncio
import errno
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace
from twisted.internet.task import Clock

from rce.api.map_jobs import File, Job, MapOptions
from rce.errors import NotFound
from rce.mapservice.job_store import JobStore, StoredJob
from rce.services.record_store import RecordStore


def job(name: str, user: str = "ann", **fields: Any) -> StoredJob:
    made = Job(name, "queued", "a.log", MapOptions(), [f"upload of {name}"], 0.0)
    return StoredJob(user, replace(made, **fields), "grant")


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def store(tmp_path: Path, clock: Clock) -> JobStore:
    return JobStore(tmp_path, clock.seconds)


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    def put(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(RecordStore, "put", put)
    return monkeypatch


def test_jobs_are_listed_oldest_first(store: JobStore) -> None:
    for name, created in (("b", 2.0), ("c", 3.0), ("a", 1.0)):
        store.add(name, job(name, created=created))
    assert [name for name, _ in store.items()] == ["a", "b", "c"]
    assert ("a" in store, "x" in store) == (True, False)
    assert store["b"].job.created == 2.0


def test_changed_job_is_loaded_after_a_restart(store: JobStore, tmp_path: Path) -> None:
    store.add("a", job("a"))
    assert store.update("a", state="running", stage="preparing")
    store.add_attempt("a")
    store.update_in_memory("a", scans=7)
    again = JobStore(tmp_path)["a"]
    assert (again.job.state, again.job.stage, again.attempts) == ("running", "preparing", 1)
    assert again.job.scans == 0, "progress is not written to disk"
    assert store["a"].job.scans == 7


def test_job_of_another_user_is_not_found(store: JobStore) -> None:
    store.add("a", job("a"))
    assert store.find("ann", "a").user == "ann"
    for user, name in (("bob", "a"), ("ann", "b")):
        with pytest.raises(NotFound, match="no job"):
            store.find(user, name)


def test_states_are_counted(store: JobStore) -> None:
    for name, state in (("a", "queued"), ("b", "done"), ("c", "done")):
        store.add(name, job(name, state=state))
    assert store.states() == {"queued": 1, "done": 2}


def test_size_of_results_is_counted_for_each_user(store: JobStore) -> None:
    store.add("a", job("a", files=[File("map.png", 10), File("log.txt", 5)]))
    store.add("b", job("b", files=[File("map.png", 100)]))
    store.add("c", job("c", "bob", files=[File("map.png", 1000)]))
    assert [store.size(user) for user in ("ann", "bob", "cleo")] == [115, 1000, 0]


@pytest.mark.parametrize(
    ("state", "needed"), [("queued", True), ("running", True), ("cancelling", True), ("done", False)]
)
def test_upload_is_needed_until_its_job_is_over(store: JobStore, state: str, needed: bool) -> None:
    store.add("a", job("a", state=state))
    assert store.uses("upload of a") == needed
    assert not store.uses("upload of b")


def test_job_that_cannot_be_written_is_not_stored(store: JobStore, full_disk: pytest.MonkeyPatch) -> None:
    with pytest.raises(OSError, match="space"):
        store.add("a", job("a"))
    assert "a" not in store


def test_running_job_continues_if_its_change_cannot_be_written(
    store: JobStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    store.add("a", job("a"))
    request.getfixturevalue("full_disk")
    assert not store.update("a", state="running")
    with pytest.raises(OSError, match="space"):
        store.add_attempt("a")
    assert (store["a"].job.state, store["a"].attempts) == ("running", 1)
    assert JobStore(tmp_path)["a"].job.state == "queued"


def test_recording_is_removed_and_results_stay(store: JobStore) -> None:
    store.add("a", job("a"))
    for directory in (store.recording("a"), store.results("a")):
        directory.mkdir()
        (directory / "file").touch()
    store.remove_recording("a")
    store.remove_recording("a")  # nothing is left to remove
    assert (store.recording("a").exists(), (store.results("a") / "file").exists()) == (False, True)


async def test_expired_jobs_are_removed_with_their_directories(store: JobStore, clock: Clock) -> None:
    store.add("old", job("old", expires=10.0))
    store.add("running", job("running"))
    clock.advance(10)
    await store.sweep()
    assert "old" in store, "at its time of expiry it is still there"
    clock.advance(1)
    await store.sweep()
    assert [name for name, _ in store.items()] == ["running"]
    assert not store.directory("old").exists()


async def test_slow_watcher_misses_changes_but_not_the_last(store: JobStore) -> None:
    store.add("a", job("a"))
    changes = store.changes("a")
    await anext(changes)
    for scans in (1, 2):
        store.update_in_memory("a", scans=scans)
    await anext(changes)
    assert store["a"].job.scans == 2
    coming = asyncio.ensure_future(anext(changes))
    await asyncio.sleep(0)
    assert not coming.done(), "nothing has changed since"
    store.update("a", state="done")
    await coming


async def test_watcher_learns_that_a_job_is_removed(store: JobStore) -> None:
    store.add("a", job("a"))
    changes = store.changes("a")
    await anext(changes)
    await store.remove("a")
    await anext(changes)
    assert "a" not in store
