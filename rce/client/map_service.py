"""Blocking client of the map service: uploads recordings, runs mapping jobs, downloads maps.

Interrupted uploads are resumed at the offset that the service has received, also by a later run of the program: the
service keeps a fingerprint of each file. Only the standard library and msgspec are needed.
"""

from __future__ import annotations

import base64
import hashlib
import http.client
import os
import socket
import ssl as tls
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import msgspec

from rce.api.map_jobs import FINAL_STATES, PREFIX, Job, JobRequest, MapOptions, Plan, PlanRequest, Upload
from rce.client.service_client import Answer, ServiceClient
from rce.errors import RceError, TimedOut, Unavailable

FIRST_CHUNK = 65_536  # bytes from which the service recognizes the file format
CHUNK = 8 * 1024 * 1024
FINGERPRINT_SAMPLE = 1024 * 1024  # bytes at each end of a file that are part of its fingerprint
MIN_DELAY, MAX_DELAY = 0.2, 5.0  # seconds between retries
OFFSET_MISMATCH = "offset_mismatch"

T = TypeVar("T")
Progress = Callable[[int], None]


class MapServiceClient(ServiceClient):
    """Client of one platform's map service. All methods block, and connect anew for each request.

    All methods raise `Unavailable` if the service cannot be reached, and otherwise the error with which it answers, for
    example `Unauthorized` or `NotFound`. `upload` and `watch` retry a broken connection; the others do not.
    """

    prefix = PREFIX

    def __init__(
        self,
        url: str,
        *,
        user: str = "",
        password: str | None = None,
        key: str | None = None,
        patience: float = 60.0,
        ssl: tls.SSLContext | None = None,
    ) -> None:
        """Prepare a client; nothing is sent yet.

        Args:
            url: URL of the platform's entry, which redirects to the service, or of the service itself.
            user: User name, with a password.
            password: Password in clear. Give either this or `key`.
            key: API key.
            patience: Seconds for which a broken connection is retried without progress.
            ssl: TLS context for https in place of the system's certificates.

        Raises:
            InvalidRequest: The URL is not http or https, or not exactly one of `password` and `key` is given.
        """
        super().__init__(url, user=user, password=password, key=key, ssl=ssl)
        self._patience = patience

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
        deadline = time.monotonic() + self._patience
        while True:
            try:
                for current in self._events(job):
                    deadline = time.monotonic() + self._patience
                    yield current
                    if current.state in FINAL_STATES:
                        return
            except (OSError, http.client.HTTPException, Unavailable) as error:
                _wait(deadline, MAX_DELAY / 5, error)

    def _events(self, job: str) -> Iterator[Job]:
        with self.connected() as connection:
            connection.request("GET", f"{PREFIX}/jobs/{job}/events", headers=self.headers)
            response = connection.getresponse()
            if response.status != 200:
                raise self.error(Answer(response.status, response.headers, response.read()))
            while line := response.readline():
                if line.startswith(b"data: "):
                    yield msgspec.json.decode(line[6:], type=Job)

    def fetch(self, job: str, name: str, file: Path) -> None:
        """Download a result.

        Args:
            job: Id of the job.
            name: Name of the result, as in `Job.files`.
            file: Path to store it under. It is written under a temporary name and then renamed.
        """
        draft = file.with_name(f".{file.name}.part")
        with self.connected() as connection:
            connection.request("GET", f"{PREFIX}/jobs/{job}/files/{name}", headers=self.headers)
            response = connection.getresponse()
            if response.status != 200:
                raise self.error(Answer(response.status, response.headers, response.read()))
            with draft.open("wb") as out:
                while chunk := response.read(CHUNK):
                    out.write(chunk)
        draft.rename(file)

    # --- uploads -----------------------------------------------------------------------------------------------------

    def upload(self, path: Path, progress: Progress = lambda _: None, name: str = "") -> Upload:
        """Upload a file, or the part of it that the service has not received yet.

        Args:
            path: File of a recording.
            progress: Function that is called with the number of bytes that have been sent.
            name: Name in place of the file's own; letters, digits, `.`, `_` and `-`.

        Raises:
            InvalidRequest: The file is not a recording; detected after the first 64 KiB.
            Unavailable: There was no progress for the time of the client's patience.
            TimedOut: The same, if the connection timed out.
        """
        upload = self._retry(lambda: self._begin(path, name or path.name))
        resource = f"/uploads/{upload.id}"
        progress(upload.offset)
        deadline, delay = time.monotonic() + self._patience, MIN_DELAY
        while upload.offset < upload.length:
            before = upload.offset
            error: Exception | None = None
            try:
                self._send(path, upload, progress)
            except (OSError, http.client.HTTPException, Unavailable) as broken:
                error = broken
            except RceError as refusal:
                if refusal.info.code != OFFSET_MISMATCH:
                    raise
            upload = self._retry(lambda: self.value(self.ask("GET", resource), Upload))
            if upload.offset > before:
                deadline, delay = time.monotonic() + self._patience, MIN_DELAY
            elif error is not None:
                _wait(deadline, delay, error)
                delay = min(2 * delay, MAX_DELAY)
        return upload

    def uploads(self) -> list[Upload]:
        """Return the user's uploads."""
        return self.value(self.ask("GET", "/uploads"), list[Upload])

    def remove_upload(self, upload: str) -> None:
        """Remove an upload that no job needs."""
        self.ask("DELETE", f"/uploads/{upload}", None, {"Tus-Resumable": "1.0.0"})

    def _begin(self, path: Path, name: str) -> Upload:
        """Return the upload of an earlier attempt, or a new one."""
        length, mark = path.stat().st_size, fingerprint(path)
        for known in self.uploads():
            if (known.name, known.length, known.fingerprint) == (name, length, mark):
                return known
        pairs = {"filename": name, "fingerprint": mark}
        metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode()}" for key, value in pairs.items())
        headers = {"Tus-Resumable": "1.0.0", "Upload-Length": str(length), "Upload-Metadata": metadata}
        return self.value(self.ask("POST", "/uploads", None, headers), Upload)

    def _send(self, path: Path, upload: Upload, progress: Progress) -> None:
        """Send the rest of the file in one request; the first request is small, so that refusals come early."""
        count = upload.length - upload.offset
        if upload.offset == 0:
            count = min(count, FIRST_CHUNK)
        with self.connected() as connection, path.open("rb") as file:
            connection.putrequest("PATCH", f"{PREFIX}/uploads/{upload.id}")
            headers = {"Content-Type": "application/offset+octet-stream", "Tus-Resumable": "1.0.0"}
            numbers = {"Upload-Offset": str(upload.offset), "Content-Length": str(count)}
            for name, value in (self.headers | headers | numbers).items():
                connection.putheader(name, value)
            connection.endheaders()
            assert isinstance(connection.sock, socket.socket)
            sent = 0
            try:
                while sent < count:
                    sent += connection.sock.sendfile(file, upload.offset + sent, min(CHUNK, count - sent))
                    progress(upload.offset + sent)
            except (BrokenPipeError, ConnectionResetError):
                pass  # the response may have the reason
            response = connection.getresponse()
            answer = Answer(response.status, response.headers, response.read())
        if answer.status != 204:
            raise self.error(answer)

    # --- requests ----------------------------------------------------------------------------------------------------

    def _retry(self, work: Callable[[], T]) -> T:
        deadline, delay = time.monotonic() + self._patience, MIN_DELAY
        while True:
            try:
                return work()
            except (OSError, http.client.HTTPException, Unavailable) as error:
                _wait(deadline, delay, error)
                delay = min(2 * delay, MAX_DELAY)


def fingerprint(path: Path) -> str:
    """Return a hash of a file's size, modification time and first and last MiB."""
    state = path.stat()
    digest = hashlib.sha256(f"{state.st_size} {state.st_mtime_ns}".encode())
    with path.open("rb") as file:
        digest.update(file.read(FINGERPRINT_SAMPLE))
        file.seek(max(0, state.st_size - FINGERPRINT_SAMPLE), os.SEEK_SET)
        digest.update(file.read(FINGERPRINT_SAMPLE))
    return digest.hexdigest()


def _wait(deadline: float, delay: float, error: Exception) -> None:
    """Wait before the next attempt, or raise the error if the deadline would pass meanwhile."""
    if time.monotonic() + delay > deadline:
        if isinstance(error, RceError):
            raise error
        kind = TimedOut if isinstance(error, TimeoutError) else Unavailable
        raise kind(f"the connection to the map service keeps breaking: {error}") from None
    time.sleep(delay)
