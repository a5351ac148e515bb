"""Jobs on a clock turned by hand: turns, retries, and what survives the death of the service."""

from __future__ import annotations

import errno
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hand_turned import HandTurnedLoop
from maps_in_memory import LIMITS, FakeMaster, FakeWorkers
from msgspec.structs import replace

from rce.errors import Died, InvalidRequest, LimitExceeded, NoCapacity, NotFound, Unavailable
from rce.map_jobs import Job, JobRequest, MapOptions
from rce.mapservice.access import Access
from rce.mapservice.jobs import Jobs
from rce.mapservice.uploads import Uploads
from rce.mapservice.work import Report


class Bench:
    """Jobs of users, without processes, ports or waiting."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.loop = HandTurnedLoop()
        self.master, self.workers = FakeMaster(), FakeWorkers()
        self.numbers = itertools.count()
        self.begin()

    def now(self) -> float:
        return 1000.0 + self.loop.time()

    def begin(self) -> None:
        def build() -> None:
            access = Access(lambda: self.master)
            place = self.directory / "jobs"
            self.jobs = Jobs(place, lambda: self.uploads, self.workers, access, LIMITS.jobs, "http://e/", now=self.now)
            self.uploads = Uploads(self.directory / "uploads", LIMITS.uploads, self.jobs.size, self.now)
            self.jobs.start()

        self.loop.do(build)

    def die(self) -> None:
        """The process is killed: it writes nothing more, and what it ran ends with it."""
        self.jobs._over = lambda *_: None  # type: ignore[assignment,method-assign]
        self.loop.begin(self.jobs.stop())
        self.workers = FakeWorkers()

    def upload(self, user: str, name: str = "a.log") -> str:
        upload = self.uploads.create(user, name, 4)
        self.uploads.path(upload.id).write_bytes(b"abcd")
        return upload.id

    def submit(self, user: str, *uploads: str) -> Job:
        wanted = JobRequest(list(uploads) or [self.upload(user)], MapOptions(resolution=0.1))
        return self.loop.begin(self.jobs.submit(user, "secret", wanted)).result()

    def job(self, job: Job, user: str = "ann") -> Job:
        self.loop.settle()
        return self.jobs.get(user, job.id)

    def finish(self, job: Job, error: BaseException | None = None) -> None:
        self.loop.do(lambda: self.workers.finish(job.id, error))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.loop.begin(bench.jobs.stop())
    bench.loop.close()


def running(bench: Bench) -> list[str]:
    return [name.split("_")[1] for name in bench.workers.running]


def test_a_job_from_its_submission_to_its_end(bench: Bench) -> None:
    job = bench.submit("ann")
    task = bench.workers.task(job.id)
    assert task.platform is not None
    assert (task.platform.user, task.platform.key, task.options.resolution) == ("ann", "rce_lent_1", 0.1)
    assert Path(task.recording).read_bytes() == b"abcd"
    bench.loop.turn(5)
    bench.loop.do(lambda: bench.workers.tell(job.id, Report("mapping", 7, 12, {"opening": 0.5})))
    seen = bench.job(job)
    assert (seen.state, seen.stage, seen.scans, seen.total) == ("running", "mapping", 7, 12)
    bench.loop.turn(5)
    bench.finish(job)
    seen = bench.job(job)
    assert (seen.state, seen.ended, seen.expires) == ("done", 1010.0, 2010.0)
    assert seen.times == {"waiting": 0, "opening": 0.5, "total": 10}
    assert [file.name for file in seen.files] == ["log.txt", "map.png", "times.json"]
    assert bench.jobs.file("ann", job.id, "map.png").read_bytes() == b"a picture"
    assert bench.jobs.size("ann") == sum(file.size for file in seen.files) > 0
    assert bench.master.grants == {}, "nobody may act for the user any more"
    assert not (bench.directory / "jobs" / job.id / "recording").exists()


def test_users_take_turns(bench: Bench) -> None:
    first, second, third = (bench.submit("ann") for _ in range(3))
    assert running(bench) == [first.id], "one job of a user at once"
    assert (bench.job(second).ahead, bench.job(third).ahead) == (0, 1)
    other = bench.submit("bob")
    assert running(bench) == [first.id, other.id]
    late = bench.submit("cleo")
    assert len(running(bench)) == 2, "two at once"
    bench.finish(first)
    assert running(bench) == [other.id, late.id], "cleo has had no turn yet"
    bench.finish(other)
    bench.finish(late)
    assert running(bench) == [second.id]


def test_so_many_may_wait(bench: Bench) -> None:
    for _ in range(4):
        bench.submit("ann")
    with pytest.raises(LimitExceeded, match="3 jobs of yours wait"):
        bench.submit("ann")
    bench.submit("bob")
    assert len(list((bench.directory / "jobs").iterdir())) == 5


def test_results_take_their_part_of_the_quota(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    upload = bench.upload("ann")
    bench.finish(bench.submit("ann", upload))
    monkeypatch.setattr(bench.uploads, "_limits", replace(LIMITS.uploads, user=bench.uploads.used("ann")))
    with pytest.raises(LimitExceeded, match="remove jobs or uploads"):
        bench.submit("ann", upload)


@pytest.mark.parametrize("error", [Unavailable("the Master is away"), NoCapacity("no machine has room")])
def test_what_is_nobodys_fault_is_tried_again(bench: Bench, error: Exception) -> None:
    job = bench.submit("ann")
    bench.finish(job, error)
    seen = bench.job(job)
    assert (seen.state, seen.stage) == ("queued", f"waiting: {error}")
    assert running(bench) == []
    bench.loop.turn(3.9)
    assert running(bench) == []
    bench.loop.turn(0.2)
    assert running(bench) == [job.id]
    task = bench.workers.task(job.id)
    assert task.name.endswith("_2")
    assert [name[-2:] for name in task.former] == ["_1"], "what the first attempt may have left"
    bench.finish(job)
    assert bench.job(job).state == "done"


def test_a_master_that_is_away_when_a_job_begins(bench: Bench) -> None:
    job = bench.submit("ann")
    waiting = bench.submit("ann")
    bench.master.away = Unavailable("the Master is away")
    bench.finish(job)
    assert bench.job(waiting).state == "queued"
    bench.master.away = None
    bench.loop.turn(10)
    assert running(bench) == [waiting.id]


def test_what_fails_says_why(bench: Bench) -> None:
    job = bench.submit("ann")
    bench.finish(job, Died("the mapping node ended with status 1"))
    seen = bench.job(job)
    assert seen.state == "failed"
    assert seen.error is not None
    assert (seen.error.code, seen.error.message) == ("died", "the mapping node ended with status 1")
    assert [file.name for file in seen.files] == ["log.txt", "times.json"]


def test_a_user_who_is_gone(bench: Bench) -> None:
    first, second = bench.submit("ann"), bench.submit("ann")
    bench.master.grants.clear()
    bench.finish(first)
    seen = bench.job(second)
    assert seen.state == "failed"
    assert seen.error is not None
    assert seen.error.code == "unauthorized"


def test_cancelling(bench: Bench) -> None:
    first, second, third = (bench.submit("ann") for _ in range(3))
    assert bench.loop.do(lambda: bench.jobs.cancel("ann", second.id)).state == "cancelled"
    assert bench.loop.do(lambda: bench.jobs.cancel("ann", first.id)).state == "cancelling"
    assert bench.job(first).state == "cancelled"
    assert running(bench) == [third.id]
    assert bench.loop.do(lambda: bench.jobs.cancel("ann", first.id)).state == "cancelled"
    bench.finish(third, Unavailable("away"))
    assert bench.loop.do(lambda: bench.jobs.cancel("ann", third.id)).state == "cancelled"
    bench.loop.turn(100)
    assert running(bench) == []
    with pytest.raises(NotFound):
        bench.jobs.cancel("bob", first.id)


def test_a_job_begins_anew_when_the_service_died(bench: Bench) -> None:
    job = bench.submit("ann")
    bench.loop.turn(1)
    waiting = bench.submit("ann")
    bench.loop.do(lambda: bench.workers.tell(job.id, Report("mapping", 7, 12)))
    bench.die()
    bench.begin()
    assert bench.job(waiting).state == "queued"
    assert running(bench) == [job.id]
    assert bench.workers.task(job.id).former == [f"map_{job.id}_1"]
    bench.finish(job)
    bench.finish(waiting)
    assert [bench.job(each).state for each in (job, waiting)] == ["done", "done"]
    bench.die()
    bench.begin()
    assert bench.job(job).files


def test_a_job_that_was_being_cancelled_when_the_service_died(bench: Bench) -> None:
    job = bench.submit("ann")
    bench.jobs._change(job.id, state="cancelling")
    bench.die()
    bench.begin()
    assert bench.job(job).state == "cancelled"
    assert [task.name for task in bench.workers.cleaned] == [f"map_{job.id}_1"]


def test_what_is_wrong_with_uploads(bench: Bench) -> None:
    whole = bench.upload("ann")
    part = bench.uploads.create("ann", "b.log", 9).id
    for names, error, field in (
        (["0" * 24], NotFound, "uploads[0]"),
        ([whole, part], InvalidRequest, "uploads[1]"),
        ([whole, bench.upload("bob")], NotFound, "uploads[1]"),
        ([whole, bench.upload("ann")], InvalidRequest, "uploads[1]"),
    ):
        task = bench.loop.begin(bench.jobs.submit("ann", "secret", JobRequest(names)))
        while not task.done():  # a thread removes what was made
            bench.loop.settle()
        with pytest.raises(error) as wrong:
            task.result()
        assert wrong.value.field == field
    assert list((bench.directory / "jobs").iterdir()) == []
    assert bench.jobs.of("ann") == []


def test_several_files_are_one_recording(bench: Bench) -> None:
    job = bench.submit("ann", bench.upload("ann", "a.mcap"), bench.upload("ann", "metadata.yaml"))
    recording = Path(bench.workers.task(job.id).recording)
    assert sorted(path.name for path in recording.iterdir()) == ["a.mcap", "metadata.yaml"]
    assert all(bench.jobs.uses(upload) for upload in job.uploads)
    bench.finish(job)
    assert not any(bench.jobs.uses(upload) for upload in job.uploads)


async def _next(changes: Any) -> Any:
    return await anext(changes)


def test_watching(bench: Bench) -> None:
    job = bench.submit("ann")
    changes = bench.jobs.watch("ann", job.id)
    assert bench.loop.begin(_next(changes)).result().state == "running"
    coming = bench.loop.begin(_next(changes))
    assert not coming.done()
    for scans in (1, 2, 3):
        bench.loop.do(lambda scans=scans: bench.workers.tell(job.id, Report("mapping", scans)))  # type: ignore[misc]
    assert coming.result().scans == 1
    bench.finish(job)
    last = bench.loop.begin(_next(changes)).result()
    assert last.state == "done"
    with pytest.raises(StopAsyncIteration):
        bench.loop.begin(_next(changes)).result()


def test_results_go_after_their_time(bench: Bench) -> None:
    job = bench.submit("ann")
    task = bench.loop.begin(bench.jobs.remove("ann", job.id))
    with pytest.raises(InvalidRequest, match="not over"):
        task.result()
    bench.finish(job)
    bench.loop.turn(999)
    bench.loop.run_until_complete(bench.jobs.sweep())
    assert bench.job(job).state == "done"
    bench.loop.turn(2)
    bench.loop.run_until_complete(bench.jobs.sweep())
    with pytest.raises(NotFound):
        bench.job(job)
    assert not (bench.directory / "jobs" / job.id).exists()


def test_the_secret_of_a_user_is_not_kept(bench: Bench) -> None:
    bench.submit("ann")
    kept = b"".join(path.read_bytes() for path in bench.directory.rglob("*") if path.is_file())
    assert b"secret" not in kept
    assert b"rce_lent" not in kept


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_that_is_full_when_a_job_begins_is_waited_for(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = bench.submit("ann"), bench.submit("ann")
    monkeypatch.setattr(bench.jobs._shelf, "put", full)
    bench.finish(first)
    assert bench.job(first).state == "done"
    assert bench.job(second).state == "queued"
    assert "disk" in bench.job(second).stage
    monkeypatch.undo()
    bench.loop.turn(100)
    assert running(bench) == [second.id]


def test_a_job_whose_end_did_not_get_to_the_disk_begins_anew(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    job = bench.submit("ann")
    monkeypatch.setattr(bench.jobs._shelf, "put", full)
    bench.finish(job)
    bench.die()
    monkeypatch.undo()
    bench.begin()
    assert bench.job(job).state == "running"
    assert Path(bench.workers.task(job.id).recording).exists()
    bench.finish(job)
    assert bench.job(job).state == "done"
