"""A client of the map service: sends recordings, has maps made of them, fetches the maps. Blocking, no dependencies.

What breaks off is resumed: an upload continues where the file on the other side ends, also by another run of the
program, because the service keeps the fingerprint of each file.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import http.client
import os
import socket
import ssl as tls
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar
from urllib.parse import urlsplit

import msgspec

from rce.errors import ErrorInfo, InvalidRequest, NotFound, RceError, TimedOut, Unavailable
from rce.map_jobs import OVER, PREFIX, Job, JobRequest, MapOptions, Problem, Upload

FIRST_PIECE = 65_536  # bytes by which the service sees what a file is
PIECE = 8 * 1024 * 1024
SAMPLE = 1024 * 1024  # bytes at both ends of a file that its fingerprint is made of
TIMEOUT = 60.0
PAUSE_FIRST, PAUSE_MOST = 0.2, 5.0
OFFSET_MISMATCH = "offset_mismatch"

T = TypeVar("T")
Told = Callable[[int], None]


class Answer(NamedTuple):
    status: int
    headers: http.client.HTTPMessage
    body: bytes


class MapService:
    """`url` is the platform's entry, which tells where the service is, or the service itself.

    Give `user` and `password` (in clear), or `key`. `patience`: seconds for which a broken connection is tried again.
    """

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
        if urlsplit(url).scheme not in ("http", "https"):
            raise InvalidRequest(f"url {url!r} must begin with http:// or https://", field="url")
        if (password is None) == (key is None):
            raise InvalidRequest("give a password or a key, one of the two", field="password")
        secret = f"Bearer {key}" if key else "Basic " + base64.b64encode(f"{user}:{password}".encode()).decode()
        self._headers = {"Authorization": secret}
        self._patience = patience
        self._ssl = ssl
        self._base = url.rstrip("/").removesuffix(PREFIX)
        self._found = False

    # --- jobs --------------------------------------------------------------------------------------------------------

    def submit(self, uploads: list[str], options: MapOptions | None = None, name: str = "") -> Job:
        """Have a map made of uploads, the files of one recording; `name` is what it is called."""
        body = msgspec.json.encode(JobRequest(uploads, options or MapOptions(), name))
        return self._value(self._ask("POST", "/jobs", body, {"Content-Type": "application/json"}), Job)

    def job(self, job: str) -> Job:
        return self._value(self._ask("GET", f"/jobs/{job}"), Job)

    def jobs(self) -> list[Job]:
        """The newest first."""
        return self._value(self._ask("GET", "/jobs"), list[Job])

    def cancel(self, job: str) -> Job:
        return self._value(self._ask("POST", f"/jobs/{job}/cancel"), Job)

    def remove(self, job: str) -> None:
        """Remove a job that is over, with its files."""
        self._ask("DELETE", f"/jobs/{job}")

    def watch(self, job: str) -> Iterator[Job]:
        """The job now and after each change, until it is over."""
        deadline = time.monotonic() + self._patience
        while True:
            try:
                for seen in self._events(job):
                    deadline = time.monotonic() + self._patience
                    yield seen
                    if seen.state in OVER:
                        return
            except (OSError, http.client.HTTPException, Unavailable) as error:
                _wait(deadline, PAUSE_MOST / 5, error)

    def _events(self, job: str) -> Iterator[Job]:
        with self._connected() as connection:
            connection.request("GET", f"{PREFIX}/jobs/{job}/events", headers=self._headers)
            response = connection.getresponse()
            if response.status != 200:
                raise _error(Answer(response.status, response.headers, response.read()))
            while line := response.readline():
                if line.startswith(b"data: "):
                    yield msgspec.json.decode(line[6:], type=Job)

    def fetch(self, job: str, name: str, file: Path) -> None:
        """Store a result under this path, which appears whole or not at all."""
        draft = file.with_name(f".{file.name}.part")
        with self._connected() as connection:
            connection.request("GET", f"{PREFIX}/jobs/{job}/files/{name}", headers=self._headers)
            response = connection.getresponse()
            if response.status != 200:
                raise _error(Answer(response.status, response.headers, response.read()))
            with draft.open("wb") as out:
                while piece := response.read(PIECE):
                    out.write(piece)
        draft.rename(file)

    # --- uploads -----------------------------------------------------------------------------------------------------

    def upload(self, path: Path, told: Told = lambda _: None, name: str = "") -> Upload:
        """Send a file, or what of it is not there yet; `told` hears how many bytes are there. `name` instead of the
        file's own: letters, digits, '.', '_' and '-'.

        Raises InvalidRequest as soon as the service sees that it is no recording, and Unavailable or TimedOut when
        nothing goes on for as long as the patience lasts.
        """
        upload = self._retry(lambda: self._begin(path, name or path.name))
        place = f"/uploads/{upload.id}"
        told(upload.offset)
        deadline, pause = time.monotonic() + self._patience, PAUSE_FIRST
        while upload.offset < upload.length:
            before = upload.offset
            error: Exception | None = None
            try:
                self._send(path, upload, told)
            except (OSError, http.client.HTTPException, Unavailable) as broken:
                error = broken
            except RceError as refused:
                if refused.info.code != OFFSET_MISMATCH:
                    raise
            upload = self._retry(lambda: self._value(self._ask("GET", place), Upload))
            if upload.offset > before:
                deadline, pause = time.monotonic() + self._patience, PAUSE_FIRST
            elif error is not None:
                _wait(deadline, pause, error)
                pause = min(2 * pause, PAUSE_MOST)
        return upload

    def _begin(self, path: Path, name: str) -> Upload:
        """What is there of the file already, or a new upload."""
        length, mark = path.stat().st_size, fingerprint(path)
        for known in self._value(self._ask("GET", "/uploads"), list[Upload]):
            if (known.name, known.length, known.fingerprint) == (name, length, mark):
                return known
        pairs = {"filename": name, "fingerprint": mark}
        metadata = ",".join(f"{key} {base64.b64encode(value.encode()).decode()}" for key, value in pairs.items())
        headers = {"Tus-Resumable": "1.0.0", "Upload-Length": str(length), "Upload-Metadata": metadata}
        return self._value(self._ask("POST", "/uploads", None, headers), Upload)

    def _send(self, path: Path, upload: Upload, told: Told) -> None:
        """One request with the rest of the file; the first one is small, to be refused early."""
        count = upload.length - upload.offset
        if upload.offset == 0:
            count = min(count, FIRST_PIECE)
        with self._connected() as connection, path.open("rb") as file:
            connection.putrequest("PATCH", f"{PREFIX}/uploads/{upload.id}")
            headers = {"Content-Type": "application/offset+octet-stream", "Tus-Resumable": "1.0.0"}
            numbers = {"Upload-Offset": str(upload.offset), "Content-Length": str(count)}
            for name, value in (self._headers | headers | numbers).items():
                connection.putheader(name, value)
            connection.endheaders()
            assert isinstance(connection.sock, socket.socket)
            sent = 0
            try:
                while sent < count:
                    sent += connection.sock.sendfile(file, upload.offset + sent, min(PIECE, count - sent))
                    told(upload.offset + sent)
            except (BrokenPipeError, ConnectionResetError):
                pass  # the answer may say why
            response = connection.getresponse()
            answer = Answer(response.status, response.headers, response.read())
        if answer.status != 204:
            raise _error(answer)

    # --- requests ----------------------------------------------------------------------------------------------------

    def _retry(self, work: Callable[[], T]) -> T:
        deadline, pause = time.monotonic() + self._patience, PAUSE_FIRST
        while True:
            try:
                return work()
            except (OSError, http.client.HTTPException, Unavailable) as error:
                _wait(deadline, pause, error)
                pause = min(2 * pause, PAUSE_MOST)

    def _ask(self, method: str, path: str, body: bytes | None = None, headers: dict[str, str] | None = None) -> Answer:
        """Unavailable where there is no answer, else the error that the answer tells."""
        try:
            with self._connected() as connection:
                connection.request(method, PREFIX + path, body, self._headers | (headers or {}))
                response = connection.getresponse()
                answer = Answer(response.status, response.headers, response.read())
        except (OSError, http.client.HTTPException) as error:
            raise Unavailable(f"cannot reach {self._base}: {error or type(error).__name__}") from None
        if answer.status >= 300:
            raise _error(answer)
        return answer

    @contextlib.contextmanager
    def _connected(self) -> Iterator[http.client.HTTPConnection]:
        if not self._found:
            self._base = self._locate()
            self._found = True
        connection = self._connection(self._base)
        try:
            yield connection
        finally:
            connection.close()

    def _connection(self, url: str) -> http.client.HTTPConnection:
        parts = urlsplit(url)
        if parts.scheme == "https":
            return http.client.HTTPSConnection(parts.netloc, timeout=TIMEOUT, context=self._ssl)
        return http.client.HTTPConnection(parts.netloc, timeout=TIMEOUT)

    def _locate(self) -> str:
        """Ask the entry where the service is."""
        connection = self._connection(self._base)
        try:
            connection.request("GET", PREFIX + "/")
            response = connection.getresponse()
            response.read()
        except (OSError, http.client.HTTPException) as error:
            raise Unavailable(f"cannot reach {self._base}: {error or type(error).__name__}") from None
        finally:
            connection.close()
        place = response.headers.get("Location", "")
        if response.status == 307 and place:
            return place.rstrip("/").removesuffix(PREFIX)
        if response.status == 200:
            return self._base
        if response.status == 503:
            raise Unavailable(f"the map service of {self._base} is away at present; try again in a moment")
        raise NotFound(f"the platform at {self._base} has no map service: start `rce map-service` there", field="url")

    @staticmethod
    def _value(answer: Answer, kind: type[T]) -> T:
        return msgspec.json.decode(answer.body, type=kind)


def fingerprint(path: Path) -> str:
    """A mark of a file's size, time and content, for which only its ends are read."""
    state = path.stat()
    mark = hashlib.sha256(f"{state.st_size} {state.st_mtime_ns}".encode())
    with path.open("rb") as file:
        mark.update(file.read(SAMPLE))
        file.seek(max(0, state.st_size - SAMPLE), os.SEEK_SET)
        mark.update(file.read(SAMPLE))
    return mark.hexdigest()


def _wait(deadline: float, pause: float, error: Exception) -> None:
    """Wait before the next try, or raise the error if there was no luck for too long."""
    if time.monotonic() + pause > deadline:
        if isinstance(error, RceError):
            raise error
        kind = TimedOut if isinstance(error, TimeoutError) else Unavailable
        raise kind(f"the connection to the map service breaks again and again: {error}") from None
    time.sleep(pause)


def _error(answer: Answer) -> RceError:
    try:
        problem = msgspec.json.decode(answer.body, type=Problem)
    except msgspec.DecodeError:
        return Unavailable(f"the map service answers with status {answer.status}")
    return RceError.from_info(ErrorInfo(problem.code, problem.detail, "", problem.field, problem.fields))
