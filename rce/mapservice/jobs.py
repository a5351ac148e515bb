"""Jobs from submission to completion: queue, execution, retries and cancellation.

A job is stored on disk before it is acknowledged, and starts again if the service dies while it runs. A process of its
own executes it as a robot of its user, with a temporary key that the Master issues for the grant of the job.
"""

from __future__ import annotations

import asyncio
import contextlib
import shutil
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Any, Protocol

import msgspec
from msgspec import Struct
from msgspec.structs import replace
from twisted.logger import Logger

from rce.api.map_jobs import FINAL_STATES, File, Job, JobRequest
from rce.control.calls.services import TemporaryKey
from rce.errors import InvalidRequest, LimitExceeded, NoCapacity, NotFound, RceError, Unavailable
from rce.mapservice.fairness import FairQueue
from rce.mapservice.inspection import InspectionQueue, Inspector, collect, recording_in
from rce.mapservice.job_program import Platform, Report, Task
from rce.mapservice.job_store import NOBODY, JobStore, StoredJob
from rce.mapservice.uploads import Uploads
from rce.process.metrics import Family, Timing, gauge_family
from rce.services.disk import service_disk_full
from rce.services.record_store import new_id

RETRY_MIN, RETRY_MAX = 2.0, 60.0  # seconds
KEY_MARGIN = 600.0  # seconds that a key is valid beyond the maximum time of a job
LOG, TIMES = "log.txt", "times.json"  # result files
DURATIONS = (1.0, 5.0, 10.0, 30.0, 60.0, 300.0, 900.0, 3600.0, 14400.0, 43200.0)  # seconds

log = Logger()
_job_seconds = Timing("rce_map_job_seconds", "Time from the submission of a job to its end", "state", bounds=DURATIONS)


class JobLimits(Struct, frozen=True):
    """Limits for jobs.

    Attributes:
        concurrent: Number of running jobs.
        per_user: Number of running jobs of one user.
        queued: Number of waiting jobs of one user.
        keep: Seconds that a job is kept after its end.
        max_time: Seconds that a job may run.
    """

    concurrent: int
    per_user: int
    queued: int
    keep: float
    max_time: float


class Runner(Inspector, Protocol):
    """Executes tasks; see `rce.mapservice.job_runner`."""

    async def build(self, task: Task, log_file: Path, on_report: Callable[[Report], None]) -> None:
        """Map a recording."""

    async def clean(self, task: Task) -> None:
        """Remove what a job may have left on the platform."""


class Grants(Protocol):
    """Rights to act for users; see `rce.services.authentication`."""

    async def create_grant(self, user: str, secret: str) -> str:
        """Get the right to act for a user; return the name of the grant."""

    async def issue_key(self, grant: str, seconds: float) -> TemporaryKey:
        """Get a key for the grant's user, valid for this time."""

    async def revoke_grant(self, grant: str) -> None:
        """Give a grant back."""


class Jobs:
    """Scheduler of all jobs."""

    def __init__(
        self,
        store: JobStore,
        uploads: Uploads,
        runner: Runner,
        grants: Grants,
        limits: JobLimits,
        entry: str,
        trust: str = "",
        now: Callable[[], float] = time.time,
    ) -> None:
        """Make a scheduler, which begins to run jobs with `start`.

        Args:
            store: Storage of the jobs.
            uploads: Uploads of which jobs are made.
            runner: Executes the jobs.
            grants: Rights to act for the users.
            limits: Limits for jobs.
            entry: URL of the robots' entry.
            trust: PEM file with the certificate of the entry; empty if a public CA has issued it.
            now: The wall clock.
        """
        self._store, self._uploads, self._runner, self._grants = store, uploads, runner, grants
        self._limits, self._entry, self._trust, self._now = limits, entry, trust, now
        self._queue = FairQueue(limits.per_user)
        self._inspections = InspectionQueue(runner)
        self._running: dict[str, asyncio.Task[None]] = {}
        self._background: set[asyncio.Task[Any]] = set()
        self._stopping = False

    def start(self) -> None:
        """Resume the jobs that an earlier process of the service has left."""
        for name, stored in self._store.items():
            if stored.user == NOBODY:
                self._in_background(self._remove_ended(name))
            if stored.job.state == "cancelling":
                self._in_background(self._resume_cancellation(name))
            elif stored.job.state in FINAL_STATES:
                self._store.remove_recording(name)
            else:
                self._store.update(name, state="queued", stage="waiting", scans=0)
                self._queue.push(stored.user, name)
        self._start_jobs()

    async def stop(self) -> None:
        """Stop running jobs; they start again with the next process of the service."""
        self._stopping = True
        for task in [*self._running.values(), *self._background]:
            task.cancel()
        await asyncio.gather(*self._running.values(), *self._background, return_exceptions=True)

    def families(self) -> list[Family]:
        """Return the metrics of the jobs."""
        states: dict[tuple[str, ...], float] = {(state,): count for state, count in self._store.states().items()}
        return [gauge_family("rce_map_jobs", "Stored jobs", ["state"], states)]

    # --- requests of users -------------------------------------------------------------------------------------------

    async def submit(self, user: str, secret: str, request: JobRequest) -> Job:
        """Inspect the recording and queue a job; `secret` authenticates the user at the Master.

        Raises:
            LimitExceeded: The user has too many waiting jobs, or no quota for results.
            RceError: The request is wrong, or the recording cannot be mapped.
        """
        waiting = self._queue.count(user) + self._inspections.count(user)
        if waiting >= self._limits.queued:
            text = f"{waiting} of your jobs are waiting, which is the limit: wait, or cancel some"
            raise LimitExceeded(text, limit=self._limits.queued)
        self._uploads.check_quota(user)
        name = new_id()
        directory = self._store.directory(name)
        directory.mkdir(mode=0o700)
        try:
            recording = collect(self._uploads, user, request.uploads, self._store.recording(name))
            total = await self._inspections.inspect(user, Task(str(recording), request.options))
            title = request.name or (recording.name if recording.is_file() else f"{len(request.uploads)} files")
            job = Job(
                name, "queued", title, request.options, request.uploads, self._now(), stage="waiting", total=total
            )
            grant = await self._grants.create_grant(user, secret)
            try:
                self._store.add(name, StoredJob(user, job, grant))
            except OSError:
                self._in_background(self._revoke(grant))
                raise
        except BaseException:
            await asyncio.to_thread(shutil.rmtree, directory, True)
            raise
        self._queue.push(user, name)
        self._start_jobs()
        return self.get(user, name)

    def get(self, user: str, name: str) -> Job:
        """Return a job of this user.

        Raises:
            NotFound: The user has no such job.
        """
        job = self._store.find(user, name).job
        return replace(job, ahead=self._queue.ahead(user, name)) if job.state == "queued" else job

    def of(self, user: str) -> list[Job]:
        """Return all jobs of a user, the newest first."""
        return [self.get(user, name) for name, stored in reversed(self._store.items()) if stored.user == user]

    async def watch(self, user: str, name: str) -> AsyncIterator[Job]:
        """Yield a job now and after changes, until it is over. A slow reader misses changes, but never the last one."""
        async for _ in self._store.changes(name):
            job = self.get(user, name)
            yield job
            if job.state in FINAL_STATES:
                return

    def cancel(self, user: str, name: str) -> Job:
        """Cancel a job; one that is over does not change."""
        state = self.get(user, name).state
        if state == "queued":
            self._queue.remove(user, name)
            self._finish(name, "cancelled")
        elif state == "running":
            self._store.update(name, state="cancelling")
            self._running[name].cancel()
        return self.get(user, name)

    async def remove(self, user: str, name: str) -> None:
        """Remove a job that is over, with its files.

        Raises:
            NotFound: The user has no such job.
            InvalidRequest: The job is not over.
        """
        if self.get(user, name).state not in FINAL_STATES:
            raise InvalidRequest(f"job {name} is not over: cancel it first", field="job")
        await self._store.remove(name)

    async def forget(self, user: str) -> None:
        """Cancel and remove all jobs of a user who was removed; a later user of the same name never sees them."""
        for name, stored in self._store.items():
            if stored.user == user:
                self.cancel(user, name)
                self._store.disown(name)
                self._in_background(self._remove_ended(name))

    async def _remove_ended(self, name: str) -> None:
        """Remove a job of nobody when it is over."""
        async for _ in self.watch(NOBODY, name):
            pass
        await self._store.remove(name)

    def file(self, user: str, name: str, file: str) -> Path:
        """Return the path of a result file.

        Raises:
            NotFound: The user has no such job, or the job has no such file.
        """
        job = self.get(user, name)
        if file not in {each.name for each in job.files}:
            files = ", ".join(each.name for each in job.files) or "none yet"
            raise NotFound(f"job {name} has no file {file[:60]}; its files are: {files}")
        return self._store.results(name) / file

    def uses(self, upload: str) -> bool:
        """Return True if a job that is not over needs this upload."""
        return self._store.uses(upload)

    # --- execution ---------------------------------------------------------------------------------------------------

    def _start_jobs(self) -> None:
        """Start waiting jobs up to the limits."""
        while not self._stopping and len(self._running) < self._limits.concurrent:
            name = self._queue.pop(Counter(self._store[each].user for each in self._running))
            if name is None:
                return
            self._running[name] = asyncio.create_task(self._run(name))

    async def _run(self, name: str) -> None:
        try:
            await self._attempt(name)
        except (Unavailable, NoCapacity) as error:
            self._retry_later(name, str(error))
        except RceError as error:
            self._finish(name, "failed", error)
        except asyncio.CancelledError:
            if self._store[name].job.state == "cancelling":
                self._finish(name, "cancelled")
        except Exception as error:  # noqa: BLE001  # a bug must not affect the jobs of others
            full = service_disk_full(error)
            if full is not None:
                self._retry_later(name, str(full))
                return
            log.failure("unhandled exception in job {name}", name=name)
            self._finish(name, "failed", RceError(f"internal error of the map service: {type(error).__name__}"))
        finally:
            self._running.pop(name, None)
            self._start_jobs()

    async def _attempt(self, name: str) -> None:
        stored = self._store[name]
        started = stored.job.started or self._now()
        self._store.update(name, state="running", stage="preparing", started=started, error=None)
        key = await self._grants.issue_key(stored.grant, self._limits.max_time + KEY_MARGIN)
        self._store.add_attempt(name)
        results = self._store.results(name)
        results.mkdir(exist_ok=True, mode=0o700)
        await self._runner.build(self._task(name, key), results / LOG, lambda report: self._report(name, report))
        self._finish(name, "done")

    def _task(self, name: str, key: TemporaryKey) -> Task:
        """Return the task of the current attempt; its environment has a new name, as the last one may still exist."""
        stored = self._store[name]
        names = [f"map_{name}_{attempt}" for attempt in range(1, stored.attempts + 1)]
        return Task(
            str(recording_in(self._store.recording(name))),
            stored.job.options,
            str(self._store.results(name)),
            names[-1],
            names[:-1],
            Platform(self._entry, key.user, key.key, self._trust),
        )

    def _report(self, name: str, report: Report) -> None:
        running = self._store[name].job.state == "running"
        if running and report.error is None and report.stage != "cancelled":
            self._store.update_in_memory(
                name, stage=report.stage, scans=report.scans, total=report.total, times=report.times
            )

    def _retry_later(self, name: str, reason: str) -> None:
        """Queue a job again after a delay, because of an error that is not the fault of its user or recording."""
        stored = self._store[name]
        if stored.job.state == "cancelling":
            self._finish(name, "cancelled")
            return
        self._store.update(name, state="queued", stage=f"waiting: {reason}", scans=0)
        delay = min(RETRY_MAX, RETRY_MIN * 2 ** min(stored.attempts, 10))

        async def retry() -> None:
            await asyncio.sleep(delay)
            if name in self._store and self._store[name].job.state == "queued":
                self._queue.push(stored.user, name, first=True)
                self._start_jobs()

        self._in_background(retry())

    async def _resume_cancellation(self, name: str) -> None:
        """Finish the cancellation of a job that was in progress when the service died."""
        stored = self._store[name]
        try:
            if stored.attempts:  # else the job was cancelled before it created an environment
                await self._runner.clean(self._task(name, await self._grants.issue_key(stored.grant, KEY_MARGIN)))
        except RceError as error:
            log.warn("environment of job {name} may still exist: {error}", name=name, error=str(error))
        self._finish(name, "cancelled")

    def _finish(self, name: str, state: Any, error: RceError | None = None) -> None:
        now, job, results = self._now(), self._store[name].job, self._store.results(name)
        waited = (job.started or now) - job.created
        times = {"waiting": round(waited, 3), **job.times, "total": round(now - job.created, 3)}
        with contextlib.suppress(OSError):  # the disk may be full
            results.mkdir(exist_ok=True, mode=0o700)
            (results / TIMES).write_bytes(msgspec.json.format(msgspec.json.encode(times)) + b"\n")
        stored = self._store.update(
            name,
            state=state,
            stage="" if error is None else job.stage,
            ended=now,
            expires=now + self._limits.keep,
            times=times,
            files=[File(path.name, path.stat().st_size) for path in sorted(results.glob("[!.]*"))],
            error=error.info if error else None,
        )
        _job_seconds.labels(state).observe(now - job.created)
        if stored:  # else the job starts again if the service ends, and still needs its recording and grant
            self._store.remove_recording(name)
            self._in_background(self._revoke(self._store[name].grant))

    async def _revoke(self, grant: str) -> None:
        try:
            await self._grants.revoke_grant(grant)
        except RceError as error:  # the key of the grant expires by itself
            log.warn("cannot revoke a grant: {error}", error=str(error))

    def _in_background(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._background.add(task)
        task.add_done_callback(self._background.discard)
