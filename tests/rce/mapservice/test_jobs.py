"""Jobs with a fake clock: scheduling, retries, cancellation, and restarts of the service."""

from __future__ import annotations

import asyncio
import errno
import functools
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from rce.api.map_jobs import Job, JobRequest, MapOptions
from rce.errors import Died, InvalidRequest, LimitExceeded, NoCapacity, NotFound, Unavailable
from rce.mapservice.job_program import Report
from rce.mapservice.job_store import JobStore
from rce.mapservice.jobs import Jobs
from rce.mapservice.uploads import Uploads
from rce.services.authentication import Authenticator
from tests.support.hand_turned import HandTurnedLoop
from tests.support.map_service import LIMITS, FakeMaster, FakeRunner


class Bench:
    """Jobs without processes, ports and real time."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.loop = HandTurnedLoop()
        self.master, self.runner = FakeMaster(), FakeRunner()
        self.numbers = itertools.count()
        self.start()

    def now(self) -> float:
        return 1000.0 + self.loop.time()

    def start(self) -> None:
        def build() -> None:
            grants = Authenticator(lambda: self.master)
            self.store = JobStore(self.directory / "jobs", self.now)
            self.uploads = Uploads(self.directory / "uploads", LIMITS.uploads, self.store.size, self.now)
            self.jobs = Jobs(self.store, self.uploads, self.runner, grants, LIMITS.jobs, "http://e/", now=self.now)
            self.jobs.start()

        self.loop.do(build)

    def die(self) -> None:
        """Kill the service: it writes nothing more, and its jobs end."""
        self.jobs._finish = lambda *_: None  # type: ignore[method-assign]
        self.loop.begin(self.jobs.stop())
        self.runner = FakeRunner()

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
        self.loop.do(lambda: self.runner.finish(job.id, error))


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.loop.begin(bench.jobs.stop())
    bench.loop.close()


def running(bench: Bench) -> list[str]:
    return [name.split("_")[1] for name in bench.runner.running]


def test_job_from_submission_to_completion(bench: Bench) -> None:
    job = bench.submit("ann")
    task = bench.runner.task(job.id)
    assert task.platform is not None
    assert (task.platform.user, task.platform.key, task.options.resolution) == ("ann", "rce_lent_1", 0.1)
    assert Path(task.recording).read_bytes() == b"abcd"
    bench.loop.turn(5)
    bench.loop.do(lambda: bench.runner.report(job.id, Report("mapping", 7, 12, {"opening": 0.5})))
    seen = bench.job(job)
    assert (seen.state, seen.stage, seen.scans, seen.total) == ("running", "mapping", 7, 12)
    bench.loop.turn(5)
    bench.finish(job)
    seen = bench.job(job)
    assert (seen.state, seen.ended, seen.expires) == ("done", 1010.0, 2010.0)
    assert seen.times == {"waiting": 0, "opening": 0.5, "total": 10}
    assert [file.name for file in seen.files] == ["log.txt", "map.png", "times.json"]
    assert bench.jobs.file("ann", job.id, "map.png").read_bytes() == b"a picture"
    assert bench.store.size("ann") == sum(file.size for file in seen.files) > 0
    assert bench.master.grants == {}, "the grant is revoked"
    assert not (bench.directory / "jobs" / job.id / "recording").exists()


def test_users_take_turns(bench: Bench) -> None:
    first, second, third = (bench.submit("ann") for _ in range(3))
    assert running(bench) == [first.id], "only one job of a user runs"
    assert (bench.job(second).ahead, bench.job(third).ahead) == (0, 1)
    other = bench.submit("bob")
    assert running(bench) == [first.id, other.id]
    late = bench.submit("cleo")
    assert len(running(bench)) == 2, "only two jobs run"
    bench.finish(first)
    assert running(bench) == [other.id, late.id], "cleo has had no turn yet"
    bench.finish(other)
    bench.finish(late)
    assert running(bench) == [second.id]


def test_number_of_waiting_jobs_is_limited(bench: Bench) -> None:
    for _ in range(4):
        bench.submit("ann")
    with pytest.raises(LimitExceeded, match="3 of your jobs are waiting"):
        bench.submit("ann")
    bench.submit("bob")
    assert len(list((bench.directory / "jobs").iterdir())) == 5


def test_results_count_towards_the_quota(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    upload = bench.upload("ann")
    bench.finish(bench.submit("ann", upload))
    monkeypatch.setattr(bench.uploads, "_limits", replace(LIMITS.uploads, user=bench.uploads.used("ann")))
    with pytest.raises(LimitExceeded, match="remove jobs or uploads"):
        bench.submit("ann", upload)


@pytest.mark.parametrize("error", [Unavailable("the Master is away"), NoCapacity("no machine has room")])
def test_job_is_retried_after_an_error_of_the_platform(bench: Bench, error: Exception) -> None:
    job = bench.submit("ann")
    bench.finish(job, error)
    seen = bench.job(job)
    assert (seen.state, seen.stage) == ("queued", f"waiting: {error}")
    assert running(bench) == []
    bench.loop.turn(3.9)
    assert running(bench) == []
    bench.loop.turn(0.2)
    assert running(bench) == [job.id]
    task = bench.runner.task(job.id)
    assert task.name.endswith("_2")
    assert [name[-2:] for name in task.former] == ["_1"], "the environment of the first attempt may still exist"
    bench.finish(job)
    assert bench.job(job).state == "done"


def test_job_waits_while_the_master_is_unreachable(bench: Bench) -> None:
    job = bench.submit("ann")
    waiting = bench.submit("ann")
    bench.master.failure = Unavailable("the Master is away")
    bench.finish(job)
    assert bench.job(waiting).state == "queued"
    bench.master.failure = None
    bench.loop.turn(10)
    assert running(bench) == [waiting.id]


def test_failed_job_has_its_error(bench: Bench) -> None:
    job = bench.submit("ann")
    bench.finish(job, Died("the mapping node ended with status 1"))
    seen = bench.job(job)
    assert seen.state == "failed"
    assert seen.error is not None
    assert (seen.error.code, seen.error.message) == ("died", "the mapping node ended with status 1")
    assert [file.name for file in seen.files] == ["log.txt", "times.json"]


def test_job_of_a_removed_user_fails(bench: Bench) -> None:
    first, second = bench.submit("ann"), bench.submit("ann")
    bench.master.grants.clear()
    bench.finish(first)
    seen = bench.job(second)
    assert seen.state == "failed"
    assert seen.error is not None
    assert seen.error.code == "unauthorized"


def test_jobs_can_be_cancelled(bench: Bench) -> None:
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


def test_running_job_starts_again_after_a_restart(bench: Bench) -> None:
    job = bench.submit("ann")
    bench.loop.turn(1)
    waiting = bench.submit("ann")
    bench.loop.do(lambda: bench.runner.report(job.id, Report("mapping", 7, 12)))
    bench.die()
    bench.start()
    assert bench.job(waiting).state == "queued"
    assert running(bench) == [job.id]
    assert bench.runner.task(job.id).former == [f"map_{job.id}_1"]
    bench.finish(job)
    bench.finish(waiting)
    assert [bench.job(each).state for each in (job, waiting)] == ["done", "done"]
    bench.die()
    bench.start()
    assert bench.job(job).files


def test_cancellation_is_completed_after_a_restart(bench: Bench) -> None:
    job = bench.submit("ann")
    bench.store.update(job.id, state="cancelling")
    bench.die()
    bench.start()
    assert bench.job(job).state == "cancelled"
    assert [task.name for task in bench.runner.cleaned] == [f"map_{job.id}_1"]


def test_cancellation_before_the_first_attempt_is_completed_after_a_restart(bench: Bench) -> None:
    bench.submit("ann")
    job = bench.submit("ann")
    bench.store.update(job.id, state="cancelling")
    bench.die()
    bench.start()
    assert bench.job(job).state == "cancelled"
    assert bench.runner.cleaned == []


def test_wrong_uploads_are_refused(bench: Bench) -> None:
    whole = bench.upload("ann")
    part = bench.uploads.create("ann", "b.log", 9).id
    for names, error, field in (
        (["0" * 24], NotFound, "uploads[0]"),
        ([whole, part], InvalidRequest, "uploads[1]"),
        ([whole, bench.upload("bob")], NotFound, "uploads[1]"),
        ([whole, bench.upload("ann")], InvalidRequest, "uploads[1]"),
    ):
        task = bench.loop.begin(bench.jobs.submit("ann", "secret", JobRequest(names)))
        while not task.done():  # a thread removes the directory of the job
            bench.loop.settle()
        with pytest.raises(error) as wrong:
            task.result()
        assert wrong.value.field == field
    assert list((bench.directory / "jobs").iterdir()) == []
    assert bench.jobs.of("ann") == []


def test_recording_of_several_files(bench: Bench) -> None:
    job = bench.submit("ann", bench.upload("ann", "a.mcap"), bench.upload("ann", "metadata.yaml"))
    recording = Path(bench.runner.task(job.id).recording)
    assert sorted(path.name for path in recording.iterdir()) == ["a.mcap", "metadata.yaml"]
    assert all(bench.jobs.uses(upload) for upload in job.uploads)
    bench.finish(job)
    assert not any(bench.jobs.uses(upload) for upload in job.uploads)


async def _next(changes: Any) -> Any:
    return await anext(changes)


def test_watch_yields_changes_until_the_job_is_over(bench: Bench) -> None:
    job = bench.submit("ann")
    changes = bench.jobs.watch("ann", job.id)
    assert bench.loop.begin(_next(changes)).result().state == "running"
    coming = bench.loop.begin(_next(changes))
    assert not coming.done()
    for scans in (1, 2, 3):
        bench.loop.do(functools.partial(bench.runner.report, job.id, Report("mapping", scans)))
    assert coming.result().scans == 1
    bench.finish(job)
    last = bench.loop.begin(_next(changes)).result()
    assert last.state == "done"
    with pytest.raises(StopAsyncIteration):
        bench.loop.begin(_next(changes)).result()


def test_results_expire(bench: Bench) -> None:
    job = bench.submit("ann")
    task = bench.loop.begin(bench.jobs.remove("ann", job.id))
    with pytest.raises(InvalidRequest, match="not over"):
        task.result()
    bench.finish(job)
    bench.loop.turn(999)
    bench.loop.run_until_complete(bench.store.sweep())
    assert bench.job(job).state == "done"
    bench.loop.turn(2)
    bench.loop.run_until_complete(bench.store.sweep())
    with pytest.raises(NotFound):
        bench.job(job)
    assert not (bench.directory / "jobs" / job.id).exists()


def test_secrets_are_not_stored(bench: Bench) -> None:
    bench.submit("ann")
    kept = b"".join(path.read_bytes() for path in bench.directory.rglob("*") if path.is_file())
    assert b"secret" not in kept
    assert b"rce_lent" not in kept


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_job_is_retried_while_the_disk_is_full(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = bench.submit("ann"), bench.submit("ann")
    monkeypatch.setattr(bench.store._records, "put", full)
    bench.finish(first)
    assert bench.job(first).state == "done"
    assert bench.job(second).state == "queued"
    assert "disk" in bench.job(second).stage
    monkeypatch.undo()
    bench.loop.turn(100)
    assert running(bench) == [second.id]


def test_job_starts_again_if_its_end_was_not_stored(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    job = bench.submit("ann")
    monkeypatch.setattr(bench.store._records, "put", full)
    bench.finish(job)
    bench.die()
    monkeypatch.undo()
    bench.start()
    assert bench.job(job).state == "running"
    assert Path(bench.runner.task(job.id).recording).exists()
    bench.finish(job)
    assert bench.job(job).state == "done"


@pytest.mark.parametrize("restart", [False, True])
def test_jobs_and_uploads_of_a_removed_user_are_removed(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, restart: bool
) -> None:
    async def at_once(function: Callable[..., None], *arguments: object) -> None:
        function(*arguments)

    monkeypatch.setattr(asyncio, "to_thread", at_once)
    over, running_job, queued = (bench.submit("ann") for _ in range(3))
    bench.finish(over)
    unused, other = bench.uploads.path(bench.upload("ann")), bench.submit("bob")
    assert bench.job(running_job).state == "running"
    bench.loop.begin(bench.jobs.forget("ann"))
    bench.loop.begin(bench.uploads.forget("ann"))
    assert bench.jobs.of("ann") == []
    assert bench.uploads.of("ann") == []
    if restart:
        bench.die()
        bench.start()
    bench.loop.settle()
    for job in (over, running_job, queued):
        assert not (bench.directory / "jobs" / job.id).exists()
    assert not unused.exists()
    assert [job.id for job in bench.jobs.of("bob")] == [other.id]
