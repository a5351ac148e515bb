"""Blocking client of the map service: uploads recordings, runs mapping jobs, downloads maps.

Only the standard library and msgspec are needed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import msgspec

from rce.api.map_jobs import FINAL_STATES, PREFIX, Job, JobRequest, MapOptions, Plan, PlanRequest, Upload
from rce.client.service_client import Answer
from rce.client.tus import MAX_DELAY, TusClient, wait_before_retry
from rce.errors import TimedOut, Unavailable


class MapServiceClient(TusClient):
    """Client of one platform's map service. All methods block, and connect anew for each request.

    All methods raise `Unavailable` if the service cannot be reached, and otherwise the error with which it answers, for
    example `Unauthorized` or `NotFound`. `upload` and `watch` retry a broken connection; the others do not.
    """

    prefix = PREFIX
    uploads_path = "/uploads"

    # --- jobs --------------------------------------------------------------------------------------------------------

    def submit(self, uploads: list[str], options: MapOptions | None = None, name: str = "") -> Job:
        """Start a mapping job.

        Args:
            uploads: Ids of finished uploads, the files of one recording.
            options: Mapper and its settings.
            name: Name of the recording; by default that of its file.
        """
        body = msgspec.json.encode(JobRequest(uploads, options or MapOptions(), name))
        return self.value(self.ask("POST", "/jobs", body, {"Content-Type": "application/json"}), Job)

    def job(self, job: str) -> Job:
        """Return a job by its id."""
        return self.value(self.ask("GET", f"/jobs/{job}"), Job)

    def jobs(self) -> list[Job]:
        """Return the user's jobs, newest first."""
        return self.value(self.ask("GET", "/jobs"), list[Job])

    def cancel(self, job: str) -> Job:
        """Cancel a job and return its new state."""
        return self.value(self.ask("POST", f"/jobs/{job}/cancel"), Job)

    def remove(self, job: str) -> None:
        """Remove a finished job with its files."""
        self.ask("DELETE", f"/jobs/{job}")

    def plan(self, job: str, request: PlanRequest) -> Plan:
        """Plan a path on the map of a finished job.

        Args:
            job: Id of the job.
            request: Start, goal, planner and its settings.

        Raises:
            RceError: There is no path; the code is `no_path`, and the field `reason` tells why.
        """
        body = msgspec.json.encode(request)
        return self.value(self.ask("POST", f"/jobs/{job}/plan", body, {"Content-Type": "application/json"}), Plan)

    def watch(self, job: str) -> Iterator[Job]:
        """Yield the job now and after each change, until it has ended."""
        deadline = time.monotonic() + self.patience
        while True:
            try:
                for current in self.events(f"/jobs/{job}/events", Job):
                    deadline = time.monotonic() + self.patience
                    yield current
                    if current.state in FINAL_STATES:
                        return
            except (Unavailable, TimedOut) as error:
                wait_before_retry(deadline, MAX_DELAY / 5, error)

    def fetch(self, job: str, name: str, file: Path) -> None:
        """Download a result.

        Args:
            job: Id of the job.
            name: Name of the result, as in `Job.files`.
            file: Path to store it under. It is written under a temporary name and then renamed.
        """
        self.download(f"/jobs/{job}/files/{name}", file)

    # --- uploads -----------------------------------------------------------------------------------------------------

    def uploads(self) -> list[Upload]:
        """Return the user's uploads."""
        return self.value(self.ask("GET", self.uploads_path), list[Upload])

    def read_upload(self, answer: Answer) -> Upload:
        """Return the upload in an answer."""
        return self.value(answer, Upload)

    def remove_upload(self, upload: str) -> None:
        """Remove an upload that no job needs."""
        self.ask("DELETE", f"{self.uploads_path}/{upload}", None, {"Tus-Resumable": "1.0.0"})
