"""Storage of jobs: their records on disk, their directories, and notification of changes."""

from __future__ import annotations

import asyncio
import shutil
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from msgspec import Struct
from msgspec.structs import replace
from twisted.logger import Logger

from rce.api.map_jobs import FINAL_STATES, Job
from rce.errors import NotFound
from rce.services.record_store import RecordStore

NOBODY = ""  # owner of the jobs of removed users
RECORDING, RESULTS = "recording", "results"  # in the directory of a job

log = Logger()


class StoredJob(Struct, frozen=True):
    """Record of a job. The name of the grant is no secret: only this service can use it."""

    user: str
    job: Job
    grant: str
    attempts: int = 0


class JobStore:
    """All jobs, in memory and on disk."""

    def __init__(self, directory: Path, now: Callable[[], float] = time.time) -> None:
        """Load the jobs; `now` is the wall clock."""
        self._records = RecordStore(directory, StoredJob)
        self._now = now
        self._jobs = self._records.load()
        self._changed: dict[str, asyncio.Event] = {}  # of the jobs that somebody watches

    def __getitem__(self, name: str) -> StoredJob:
        return self._jobs[name]

    def __contains__(self, name: str) -> bool:
        return name in self._jobs

    def items(self) -> list[tuple[str, StoredJob]]:
        """Return all jobs by name, the oldest first."""
        return sorted(self._jobs.items(), key=lambda item: item[1].job.created)

    def states(self) -> Counter[str]:
        """Return the number of jobs in each state."""
        return Counter(stored.job.state for stored in self._jobs.values())

    def find(self, user: str, name: str) -> StoredJob:
        """Return a job of this user.

        Raises:
            NotFound: The user has no such job.
        """
        stored = self._jobs.get(name)
        if stored is None or stored.user != user:
            raise NotFound(f"there is no job {name[:64]}; it may have expired")
        return stored

    def directory(self, name: str) -> Path:
        """Return the directory of a job."""
        return self._records.path(name)

    def recording(self, name: str) -> Path:
        """Return the directory with the recording of a job."""
        return self.directory(name) / RECORDING

    def results(self, name: str) -> Path:
        """Return the directory with the results of a job."""
        return self.directory(name) / RESULTS

    def size(self, user: str) -> int:
        """Return the number of bytes of a user's results."""
        return sum(file.size for stored in self._jobs.values() if stored.user == user for file in stored.job.files)

    def uses(self, upload: str) -> bool:
        """Return True if a job that is not over needs this upload."""
        return any(
            upload in stored.job.uploads and stored.job.state not in FINAL_STATES for stored in self._jobs.values()
        )

    def add(self, name: str, stored: StoredJob) -> None:
        """Store a new job.

        Raises:
            OSError: The job cannot be written; it is not stored.
        """
        self._records.put(name, stored)
        self._jobs[name] = stored

    def add_attempt(self, name: str) -> None:
        """Count an attempt at a job.

        Raises:
            OSError: The number cannot be written to disk; it is counted all the same.
        """
        stored = self._jobs[name]
        self._jobs[name] = replace(stored, attempts=stored.attempts + 1)
        self._records.put(name, self._jobs[name])

    def update(self, name: str, **fields: Any) -> bool:
        """Change fields of a job; return False if the change could not be written to disk.

        The job continues all the same. If the service ends before a later change is written, the job starts again.
        """
        self.update_in_memory(name, **fields)
        try:
            self._records.put(name, self._jobs[name])
        except OSError as error:
            log.error("cannot store the state of job {name}: {error}", name=name, error=str(error))
            return False
        return True

    def disown(self, name: str) -> None:
        """Take a job away from its user, who was removed."""
        self._jobs[name] = replace(self._jobs[name], user=NOBODY)
        self._records.put(name, self._jobs[name])

    def update_in_memory(self, name: str, **fields: Any) -> None:
        """Change fields of a job that are not needed after a restart."""
        stored = self._jobs[name]
        self._jobs[name] = replace(stored, job=replace(stored.job, **fields))
        self._notify(name)

    def remove_recording(self, name: str) -> None:
        """Remove the links to the uploads of a job; the uploads stay."""
        shutil.rmtree(self.recording(name), ignore_errors=True)

    async def remove(self, name: str) -> None:
        """Remove a job with its directory."""
        self._jobs.pop(name, None)
        self._notify(name)
        await asyncio.to_thread(shutil.rmtree, self.directory(name), True)

    async def sweep(self) -> None:
        """Remove expired jobs."""
        for name, stored in list(self._jobs.items()):
            if stored.job.expires is not None and stored.job.expires < self._now():
                await self.remove(name)

    async def changes(self, name: str) -> AsyncIterator[None]:
        """Yield now and after changes of a job. A slow reader misses changes, but never the last one."""
        while True:
            event = self._changed.setdefault(name, asyncio.Event())
            yield
            await event.wait()

    def _notify(self, name: str) -> None:
        event = self._changed.pop(name, None)
        if event is not None:
            event.set()
