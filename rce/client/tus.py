"""Blocking client of resumable uploads by tus 1.0.

Interrupted uploads are resumed at the offset that the server has received, also by a later run of the program: the
server keeps a fingerprint of each file. Only the standard library and msgspec are needed.
"""

from __future__ import annotations

import base64
import hashlib
import http.client
import os
import socket
import ssl as tls
import time
from abc import abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, TypeVar

from rce.api.map_jobs import Upload
from rce.client.service_client import Answer, ServiceClient
from rce.errors import RceError, TimedOut, Unavailable

FIRST_CHUNK = 65_536  # bytes from which the server recognizes the file format
CHUNK = 8 * 1024 * 1024
FINGERPRINT_SAMPLE = 1024 * 1024  # bytes at each end of a file that are part of its fingerprint
MIN_DELAY, MAX_DELAY = 0.2, 5.0  # seconds between retries
OFFSET_MISMATCH = "offset_mismatch"

T = TypeVar("T")
Progress = Callable[[int], None]


class TusClient(ServiceClient):
    """Base of clients that upload files. All methods block, and connect anew for each request.

    All methods raise `Unavailable` if the server cannot be reached, and otherwise the error with which it answers, for
    example `Unauthorized` or `NotFound`. `upload` retries a broken connection.

    Attributes:
        uploads_path: Path of the uploads, below the prefix.
        patience: Seconds for which a broken connection is retried without progress.
    """

    uploads_path: ClassVar[str]

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
        self.patience = patience

    @abstractmethod
    def uploads(self) -> list[Upload]:
        """Return the user's uploads."""

    @abstractmethod
    def read_upload(self, answer: Answer) -> Upload:
        """Return the upload in an answer."""

    def upload(self, path: Path, progress: Progress = lambda _: None, name: str = "") -> Upload:
        """Upload a file, or the part of it that the server has not received yet.

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
        resource = f"{self.uploads_path}/{upload.id}"
        progress(upload.offset)
        deadline, delay = time.monotonic() + self.patience, MIN_DELAY
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
            upload = self._retry(lambda: self.read_upload(self.ask("GET", resource)))
            if upload.offset > before:
                deadline, delay = time.monotonic() + self.patience, MIN_DELAY
            elif error is not None:
                wait_before_retry(deadline, delay, error)
                delay = min(2 * delay, MAX_DELAY)
        return upload

    def _begin(self, path: Path, name: str) -> Upload:
        """Return the upload of an earlier attempt, or a new one."""
        length, mark = path.stat().st_size, fingerprint(path)
        for known in self.uploads():
            if (known.name, known.length, known.fingerprint) == (name, length, mark):
                return known
        pairs = {"filename": name, "fingerprint": mark}
        metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode()}" for key, value in pairs.items())
        headers = {"Tus-Resumable": "1.0.0", "Upload-Length": str(length), "Upload-Metadata": metadata}
        return self.read_upload(self.ask("POST", self.uploads_path, None, headers))

    def _send(self, path: Path, upload: Upload, progress: Progress) -> None:
        """Send the rest of the file in one request; the first request is small, so that refusals come early."""
        count = upload.length - upload.offset
        if upload.offset == 0:
            count = min(count, FIRST_CHUNK)
        with self.connected() as connection, path.open("rb") as file:
            connection.putrequest("PATCH", f"{self.prefix}{self.uploads_path}/{upload.id}")
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
        deadline, delay = time.monotonic() + self.patience, MIN_DELAY
        while True:
            try:
                return work()
            except (OSError, http.client.HTTPException, Unavailable) as error:
                wait_before_retry(deadline, delay, error)
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


def wait_before_retry(deadline: float, delay: float, error: Exception) -> None:
    """Wait before the next attempt, or raise the error if the deadline would pass meanwhile."""
    if time.monotonic() + delay > deadline:
        if isinstance(error, RceError):
            raise error
        kind = TimedOut if isinstance(error, TimeoutError) else Unavailable
        raise kind(f"the connection keeps breaking: {error}") from None
    time.sleep(delay)
