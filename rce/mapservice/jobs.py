"""Jobs from their submission to their end: who waits, what runs, what is kept.

A job is taken to disk before it is acknowledged, and begins anew when the service dies in the midst of it. It is done
by a process of its own, as a robot of its user, with a key that the Master lends for the grant that the job was given.
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

from rce.calls.services import LentKey
from rce.errors import InvalidRequest, LimitExceeded, NoCapacity, NotFound, RceError, Unavailable
from rce.map_jobs import OVER, File, Job, JobRequest
from rce.mapservice.fairness import FairQueue
from rce.mapservice.files import DiskFull, Shelf, new_id
from rce.mapservice.intake import Intake, Looker, collect, collected
from rce.mapservice.uploads import Uploads
from rce.mapservice.work import Platform, Report, Task
from rce.metrics import Family, Timing, gauge

RETRY_FIRST, RETRY_MOST = 2.0, 60.0
RECORDING, RESULTS, LOG, TIMES = "recording", "results", "log.txt", "times.json"
LASTING = (1.0, 5.0, 10.0, 30.0, 60.0, 300.0, 900.0, 3600.0, 14400.0, 43200.0)  # seconds

log = Logger()
_lasted = Timing("rce_map_job_seconds", "From the submission of a job to its end", "state", bounds=LASTING)


class Limits(Struct, frozen=True):
    """`at_once` jobs run, `per_user` of one user, and `queued` of one user may wait. Seconds: kept, and run at most."""

    at_once: int
    per_user: int
    queued: int
    keep: float
    longest: float


class Workers(Looker, Protocol):
    """What does the work; see `rce.mapservice.worker`."""

    async def build(self, task: Task, log_file: Path, heard: Callable[[Report], None]) -> None: ...
    async def clean(self, task: Task) -> None: ...


class Rights(Protocol):
    """The right to act for the users; see `rce.mapservice.access`."""

    async def delegate(self, user: str, secret: str) -> str: ...
    async def borrow(self, grant: str, seconds: float) -> LentKey: ...
    async def end(self, grant: str) -> None: ...


class Kept(Struct, frozen=True):
    """A job as it is kept; the grant is a name that opens nothing for others."""

    user: str
    job: Job
    grant: str
    attempts: int = 0


class Jobs:
    """All jobs. `entry`: where robots enter the platform; `trust`: the certificate to trust there."""

    def __init__(
        self,
        directory: Path,
        uploads: Callable[[], Uploads],
        workers: Workers,
        rights: Rights,
        limits: Limits,
        entry: str,
        trust: str = "",
        now: Callable[[], float] = time.time,
    ) -> None:
        self._shelf = Shelf(directory, Kept)
        self._uploads = uploads
        self._workers, self._rights, self._limits = workers, rights, limits
        self._entry, self._trust, self._now = entry, trust, now
        self._kept = self._shelf.load()
        self._queue = FairQueue(limits.per_user)
        self._running: dict[str, asyncio.Task[None]] = {}
        self._changes: dict[str, asyncio.Event] = {}  # of jobs that somebody watches
        self._tasks: set[asyncio.Task[Any]] = set()
        self._stopping = False
        self._intake = Intake(workers)

    def start(self) -> None:
        """Take up where an earlier life of the service ended."""
        for name, kept in sorted(self._kept.items(), key=lambda item: item[1].job.created):
            if kept.job.state == "cancelling":
                self._do(self._cancel_again(name))
            elif kept.job.state in OVER:
                self._remove_links(name)
            else:
                self._change(name, state="queued", stage="waiting", scans=0)
                self._queue.push(kept.user, name)
        self._begin()

    async def stop(self) -> None:
        """What runs begins anew in the next life."""
        self._stopping = True
        for task in [*self._running.values(), *self._tasks]:
            task.cancel()
        await asyncio.gather(*self._running.values(), *self._tasks, return_exceptions=True)

    def families(self) -> list[Family]:
        """How many jobs are in each state."""
        states = Counter(kept.job.state for kept in self._kept.values())
        return [gauge("rce_map_jobs", "Jobs that are kept", ["state"], {(state,): n for state, n in states.items()})]

    # --- what users ask for ------------------------------------------------------------------------------------------

    async def submit(self, user: str, secret: str, request: JobRequest) -> Job:
        """Look at the recording, and queue the job. Raises what is wrong with either."""
        waiting = self._queue.count(user) + self._intake.count(user)
        if waiting >= self._limits.queued:
            text = f"{waiting} jobs of yours wait already, and {self._limits.queued} may: wait, or cancel some"
            raise LimitExceeded(text, limit=self._limits.queued)
        self._uploads().check_quota(user)
        name = new_id()
        place = self._shelf.place(name)
        place.mkdir(mode=0o700)
        try:
            recording = collect(self._uploads(), user, request.uploads, place / RECORDING)
            total = await self._intake.look(user, Task(str(recording), request.options))
            called = request.name or (recording.name if recording.is_file() else f"{len(request.uploads)} files")
            job = Job(
                name, "queued", called, request.options, request.uploads, self._now(), stage="waiting", total=total
            )
            grant = await self._rights.delegate(user, secret)
            try:
                self._shelf.put(name, Kept(user, job, grant))
            except OSError:
                self._do(self._end_grant(grant))
                raise
        except BaseException:
            await asyncio.to_thread(shutil.rmtree, place, True)
            raise
        self._kept[name] = Kept(user, job, grant)
        self._queue.push(user, name)
        self._begin()
        return self.get(user, name)

    def get(self, user: str, name: str) -> Job:
        """NotFound also for another user's."""
        kept = self._kept.get(name)
        if kept is None or kept.user != user:
            raise NotFound(f"there is no job {name[:64]}; it may have expired")
        return replace(kept.job, ahead=self._queue.ahead(user, name)) if kept.job.state == "queued" else kept.job

    def of(self, user: str) -> list[Job]:
        """The newest first."""
        own = [self.get(user, name) for name, kept in self._kept.items() if kept.user == user]
        return sorted(own, key=lambda job: -job.created)

    async def watch(self, user: str, name: str) -> AsyncIterator[Job]:
        """The job now and after each change; who reads slowly misses some, never the last. Ends when it is over."""
        while True:
            event = self._changes.setdefault(name, asyncio.Event())
            job = self.get(user, name)
            yield job
            if job.state in OVER:
                return
            await event.wait()

    def cancel(self, user: str, name: str) -> Job:
        """A job that is over stays what it is."""
        state = self.get(user, name).state
        if state == "queued":
            self._queue.remove(user, name)
            self._over(name, "cancelled")
        elif state == "running":
            self._change(name, state="cancelling")
            self._running[name].cancel()
        return self.get(user, name)

    async def remove(self, user: str, name: str) -> None:
        """Remove a job that is over, with its files. InvalidRequest before that."""
        if self.get(user, name).state not in OVER:
            raise InvalidRequest(f"job {name} is not over: cancel it first", field="job")
        await self._drop(name)

    def file(self, user: str, name: str, file: str) -> Path:
        """A result. NotFound."""
        job = self.get(user, name)
        if file not in {each.name for each in job.files}:
            have = ", ".join(each.name for each in job.files) or "none yet"
            raise NotFound(f"job {name} has no file {file[:60]}; it has: {have}")
        return self._shelf.place(name) / RESULTS / file

    def size(self, user: str) -> int:
        """Bytes of a user's results."""
        return sum(file.size for kept in self._kept.values() if kept.user == user for file in kept.job.files)

    def uses(self, upload: str) -> bool:
        """Whether a job that is not over needs this upload."""
        return any(upload in kept.job.uploads and kept.job.state not in OVER for kept in self._kept.values())

    async def sweep(self) -> None:
        """Remove what has expired."""
        for name, kept in list(self._kept.items()):
            if kept.job.expires is not None and kept.job.expires < self._now():
                await self._drop(name)

    # --- the work ----------------------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Start what may run now."""
        while not self._stopping and len(self._running) < self._limits.at_once:
            name = self._queue.pop(Counter(self._kept[each].user for each in self._running))
            if name is None:
                return
            self._running[name] = asyncio.create_task(self._work(name))

    async def _work(self, name: str) -> None:
        try:
            await self._attempt(name)
        except (Unavailable, NoCapacity) as error:
            self._wait(name, str(error))
        except RceError as error:
            self._over(name, "failed", error)
        except asyncio.CancelledError:
            if self._kept[name].job.state == "cancelling":
                self._over(name, "cancelled")
        except Exception as error:  # noqa: BLE001  # a defect; the others' jobs go on
            full = DiskFull.of(error)
            if full is not None:
                self._wait(name, str(full))
                return
            log.failure("defect in job {name}", name=name)
            self._over(name, "failed", RceError(f"a defect of the map service: {type(error).__name__}"))
        finally:
            self._running.pop(name, None)
            self._begin()

    async def _attempt(self, name: str) -> None:
        kept = self._kept[name]
        began = self._now()
        self._change(name, state="running", stage="preparing", started=kept.job.started or began, error=None)
        lent = await self._rights.borrow(kept.grant, self._limits.longest + 600)
        kept = replace(self._kept[name], attempts=kept.attempts + 1)
        self._kept[name] = kept
        self._shelf.put(name, kept)
        place = self._shelf.place(name)
        (place / RESULTS).mkdir(exist_ok=True, mode=0o700)
        await self._workers.build(
            self._task(name, lent), place / RESULTS / LOG, lambda report: self._heard(name, report)
        )
        self._over(name, "done")

    def _task(self, name: str, lent: LentKey) -> Task:
        """Robot and environment have a name of their own in each attempt: the last one's may still be there."""
        kept = self._kept[name]
        recording = collected(self._shelf.place(name) / RECORDING)
        tags = [f"map_{name}_{attempt}" for attempt in range(1, kept.attempts + 1)]
        return Task(
            str(recording),
            kept.job.options,
            str(self._shelf.place(name) / RESULTS),
            tags[-1],
            tags[:-1],
            Platform(self._entry, lent.user, lent.key, self._trust),
        )

    def _heard(self, name: str, report: Report) -> None:
        kept = self._kept[name]
        if kept.job.state == "running" and report.error is None and report.stage != "cancelled":
            job = replace(kept.job, stage=report.stage, scans=report.scans, total=report.total, times=report.times)
            self._kept[name] = replace(kept, job=job)  # not to disk: it begins anew if we die
            self._tell(name)

    def _wait(self, name: str, reason: str) -> None:
        """Back into the queue for a while: neither the recording nor the user is at fault."""
        kept = self._kept[name]
        if kept.job.state == "cancelling":
            self._over(name, "cancelled")
            return
        self._change(name, state="queued", stage=f"waiting: {reason}", scans=0)
        pause = min(RETRY_MOST, RETRY_FIRST * 2 ** min(kept.attempts, 10))

        async def later() -> None:
            await asyncio.sleep(pause)
            if name in self._kept and self._kept[name].job.state == "queued":
                self._queue.push(kept.user, name, first=True)
                self._begin()

        self._do(later())

    async def _cancel_again(self, name: str) -> None:
        """A job that was being cancelled when the service died."""
        kept = self._kept[name]
        try:
            await self._workers.clean(self._task(name, await self._rights.borrow(kept.grant, 600)))
        except RceError as error:
            log.warn("environment of job {name} may be left: {error}", name=name, error=str(error))
        self._over(name, "cancelled")

    def _over(self, name: str, state: Any, error: RceError | None = None) -> None:
        place, now = self._shelf.place(name), self._now()
        job = self._kept[name].job
        waited = (job.started or now) - job.created
        times = {"waiting": round(waited, 3), **job.times, "total": round(now - job.created, 3)}
        results = place / RESULTS
        with contextlib.suppress(OSError):  # a full disk; what is there is told all the same
            results.mkdir(exist_ok=True, mode=0o700)
            (results / TIMES).write_bytes(msgspec.json.format(msgspec.json.encode(times)) + b"\n")
        files = [File(path.name, path.stat().st_size) for path in sorted(results.glob("[!.]*"))]
        expires = now + self._limits.keep
        stage = "" if error is None else job.stage
        info = error.info if error else None
        noted = self._change(
            name, state=state, stage=stage, ended=now, expires=expires, times=times, files=files, error=info
        )
        _lasted.of(state).observe(now - job.created)
        if noted:
            self._remove_links(name)
            self._do(self._end_grant(self._kept[name].grant))

    async def _end_grant(self, grant: str) -> None:
        try:
            await self._rights.end(grant)
        except RceError as error:  # its key expires by itself
            log.warn("a grant could not be ended: {error}", error=str(error))

    def _remove_links(self, name: str) -> None:
        """The recording of a job that is over; the uploads themselves stay."""
        shutil.rmtree(self._shelf.place(name) / RECORDING, ignore_errors=True)

    def _change(self, name: str, **fields: Any) -> bool:
        """Whether it is on disk too. Where that takes nothing, the job goes on all the same; if the service ends then,
        it begins anew.
        """
        kept = self._kept[name]
        self._kept[name] = replace(kept, job=replace(kept.job, **fields))
        noted = True
        try:
            self._shelf.put(name, self._kept[name])
        except OSError as error:
            log.error("the state of job {name} is not on disk: {error}", name=name, error=str(error))
            noted = False
        self._tell(name)
        return noted

    def _tell(self, name: str) -> None:
        event = self._changes.pop(name, None)
        if event is not None:
            event.set()

    async def _drop(self, name: str) -> None:
        self._kept.pop(name, None)
        self._tell(name)
        await asyncio.to_thread(shutil.rmtree, self._shelf.place(name), True)

    def _do(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
