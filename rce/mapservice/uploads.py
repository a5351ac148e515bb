"""Resumable uploads: streamed to disk, within the quota of their user."""

from __future__ import annotations

import asyncio
import os
import shutil
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from rce.api.map_jobs import Upload
from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.mapservice.file_types import HEAD_SIZE, check_head, suffix_of
from rce.process.metrics import Counter
from rce.services.record_store import RecordStore, check_file_name, new_id

CHUNK = 4 * 1024 * 1024  # bytes that are written at once
DAY = 86_400.0
MAX_FILES = 1000  # of one user
INCOMPLETE_KEPT = DAY  # seconds that an incomplete upload is kept after its last data

_received = Counter("rce_map_upload_bytes", "Bytes of received recordings")


class UploadLimits(Struct, frozen=True):
    """Limits for uploads.

    Attributes:
        file: Bytes of one file.
        user: Bytes of all uploads and results of one user.
        spare: Bytes of the disk that stay free.
        keep: Seconds that a complete upload is kept after its last use.
    """

    file: int
    user: int
    spare: int
    keep: float


class StoredUpload(Struct, frozen=True):
    """Record of an upload. `used` is the time of its last data, or of the last job with it."""

    user: str
    name: str
    length: int
    used: float
    fingerprint: str = ""


class OffsetMismatch(InvalidRequest):
    """The client continues at another offset than the end of the file; `fields` has the right offset."""

    code = "offset_mismatch"


class Uploads:
    """All uploads."""

    def __init__(
        self, directory: Path, limits: UploadLimits, results: Callable[[str], int], now: Callable[[], float] = time.time
    ) -> None:
        """Load the uploads.

        Args:
            directory: Directory of the uploads.
            limits: Limits for uploads.
            results: Returns the bytes of a user's quota that results of jobs take.
            now: The wall clock.
        """
        self._store = RecordStore(directory, StoredUpload)
        self._limits = limits
        self._results = results
        self._now = now
        self._stored = self._store.load()
        self._writers: dict[str, asyncio.Task[object]] = {}

    @property
    def largest(self) -> int:
        """Maximum size of a file in bytes."""
        return self._limits.file

    def create(self, user: str, name: str, length: int, fingerprint: str = "") -> Upload:
        """Announce an upload of `length` bytes; `fingerprint` is kept for the client.

        Raises:
            InvalidRequest: The name is not that of a recording, or the file is empty.
            LimitExceeded: The file is too large for the limits, the quota or the disk.
        """
        suffix_of(check_file_name(name, "Upload-Metadata.filename"))
        if length < 1:
            raise InvalidRequest(f"{name} is empty", field="Upload-Length")
        if length > self._limits.file:
            raise _exceeded("a file may have at most {limit} bytes", self._limits.file, length)
        if len(self.of(user)) >= MAX_FILES:
            text = f"you have {MAX_FILES} files here, which is the limit: remove some of them"
            raise LimitExceeded(text, limit=MAX_FILES)
        used = self.used(user)
        if used + length > self._limits.user:
            raise _exceeded(
                f"you have {used} bytes here; all your files may have at most {{limit}} bytes",
                self._limits.user,
                length,
            )
        free = shutil.disk_usage(self._store.directory).free - sum(self._missing(each) for each in self._stored)
        if length > free - self._limits.spare:
            raise _exceeded(
                "disk full (map service): there is room for {limit} bytes", max(0, free - self._limits.spare), length
            )
        upload, stored = new_id(), StoredUpload(user, name, length, self._now(), fingerprint[:128])
        path = self._store.path(upload)
        try:
            path.mkdir(mode=0o700)
            (path / name).touch(mode=0o600)
            self._store.put(upload, stored)
        except OSError:
            shutil.rmtree(path, ignore_errors=True)
            raise
        self._stored[upload] = stored
        return self.get(user, upload)

    def check_quota(self, user: str) -> None:
        """Check that the user may have more results.

        Raises:
            LimitExceeded: The quota is used up.
        """
        used = self.used(user)
        if used >= self._limits.user:
            text = f"you have {used} bytes here, of at most {self._limits.user}: remove jobs or uploads"
            raise LimitExceeded(text, limit=self._limits.user)

    def get(self, user: str, upload: str, field: str = "") -> Upload:
        """Return an upload of this user.

        Raises:
            NotFound: The user has no such upload; the error names `field`.
        """
        stored = self._stored.get(upload)
        if stored is None or stored.user != user:
            raise NotFound(f"there is no upload {upload[:64]}; it may have expired", field=field)
        expires = stored.used + (INCOMPLETE_KEPT if self._missing(upload) else self._limits.keep)
        return Upload(upload, stored.name, stored.length, self.offset(upload), expires, stored.fingerprint)

    def of(self, user: str) -> list[Upload]:
        """Return all uploads of a user."""
        return [self.get(user, upload) for upload, stored in self._stored.items() if stored.user == user]

    def used(self, user: str) -> int:
        """Return the used bytes of a user's quota, including announced data that has not come yet."""
        return sum(stored.length for stored in self._stored.values() if stored.user == user) + self._results(user)

    def path(self, upload: str) -> Path:
        """Return the path of the file."""
        return self._store.path(upload) / self._stored[upload].name

    def offset(self, upload: str) -> int:
        """Return the number of bytes received so far."""
        return self.path(upload).stat().st_size

    def _missing(self, upload: str) -> int:
        return self._stored[upload].length - self.offset(upload)

    async def append(self, user: str, upload: str, offset: int, pieces: AsyncIterator[bytes]) -> Upload:
        """Append data to an upload. If the data breaks off, the received part is kept.

        A call cancels an earlier one for the same upload, whose connection may hang.

        Raises:
            NotFound: The user has no such upload.
            OffsetMismatch: `offset` is not the end of the file.
            InvalidRequest: There is more data than announced, or it is not a recording; the upload is removed.
        """
        found = self.get(user, upload)
        task = asyncio.current_task()
        assert task is not None
        before = self._writers.get(upload)
        self._writers[upload] = task
        if before is not None:
            before.cancel()
            await asyncio.wait({before})
        try:
            found = self.get(user, upload)
            if offset != found.offset:
                raise OffsetMismatch(
                    f"{found.name} has {found.offset} bytes so far, so it must be continued there and not at {offset}",
                    field="Upload-Offset",
                    offset=found.offset,
                )
            await self._write(found, pieces)
        finally:
            if self._writers.get(upload) is task:
                del self._writers[upload]
        self.touch(upload)
        return self.get(user, upload)

    async def _write(self, upload: Upload, pieces: AsyncIterator[bytes]) -> None:
        writer = _Writer(self.path(upload.id), upload)
        try:
            async for piece in pieces:
                await writer.write(piece)
        except InvalidRequest:
            await writer.close(keep=False)
            await self._drop(upload.id)
            raise
        except BaseException:
            await writer.close()
            raise
        await writer.close()
        if not self._missing(upload.id):
            try:
                # The writer has not checked a file of less than HEAD_SIZE bytes.
                check_head(upload.name, _head(self.path(upload.id)))
            except InvalidRequest:
                await self._drop(upload.id)
                raise

    def touch(self, upload: str) -> None:
        """Restart the time for which an upload is kept."""
        self._stored[upload] = replace(self._stored[upload], used=self._now())
        self._store.put(upload, self._stored[upload])

    async def remove(self, user: str, upload: str) -> None:
        """Remove an upload and cancel a call that appends to it; raise NotFound if the user has no such upload."""
        self.get(user, upload)
        writer = self._writers.get(upload)
        if writer is not None:
            writer.cancel()
            await asyncio.wait({writer})
        await self._drop(upload)

    async def forget(self, user: str) -> None:
        """Remove all uploads of a user who was removed."""
        await asyncio.gather(*(self.remove(user, upload.id) for upload in self.of(user)))

    async def _drop(self, upload: str) -> None:
        self._stored.pop(upload, None)
        await asyncio.to_thread(shutil.rmtree, self._store.path(upload), True)

    async def sweep(self, in_use: Callable[[str], bool]) -> None:
        """Remove expired uploads, except those that are `in_use`."""
        for upload, stored in list(self._stored.items()):
            expired = self.get(stored.user, upload).expires < self._now()
            if expired and upload not in self._writers and not in_use(upload):
                await self._drop(upload)


class _Writer:
    """Collects data into chunks and writes each in a thread while the next one comes in."""

    def __init__(self, path: Path, upload: Upload) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND)
        self._name = upload.name
        self._room = upload.length - upload.offset
        self._head: bytearray | None = bytearray(_head(path)) if upload.offset < HEAD_SIZE else None
        self._pieces: list[bytes] = []
        self._size = 0
        self._write: asyncio.Future[None] | None = None

    async def write(self, piece: bytes) -> None:
        """Add data; raise InvalidRequest if it is too much or not a recording."""
        self._room -= len(piece)
        if self._room < 0:
            raise InvalidRequest(f"{self._name} has more bytes than its Upload-Length says", field="Upload-Length")
        if self._head is not None:
            self._head += piece[:HEAD_SIZE]
            if len(self._head) >= HEAD_SIZE:
                check_head(self._name, bytes(self._head[:HEAD_SIZE]))
                self._head = None
        _received.add(by=len(piece))
        self._pieces.append(piece)
        self._size += len(piece)
        if self._size >= CHUNK:
            await self._flush()

    async def _flush(self) -> None:
        pieces, self._pieces, self._size = self._pieces, [], 0
        if self._write is not None:
            await asyncio.shield(self._write)
        self._write = asyncio.get_running_loop().run_in_executor(None, _write_all, self._file, pieces)

    async def close(self, keep: bool = True) -> None:
        """Write the rest, unless `keep` is false, and wait for all writes to end, even if cancelled."""
        end = asyncio.ensure_future(self._close(keep))
        try:
            await asyncio.shield(end)
        except asyncio.CancelledError:
            await end
            raise

    async def _close(self, keep: bool) -> None:
        try:
            if keep:
                await self._flush()
            if self._write is not None:
                await self._write
        finally:
            os.close(self._file)


def _write_all(file: int, pieces: list[bytes]) -> None:
    data = pieces if len(pieces) <= os.sysconf("SC_IOV_MAX") else [b"".join(pieces)]
    written, size = os.writev(file, data), sum(map(len, pieces))
    if written < size:  # the disk is nearly full; the next write raises the error
        rest = memoryview(b"".join(pieces))[written:]
        while rest:
            rest = rest[os.write(file, rest) :]


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD_SIZE)


def _exceeded(what: str, limit: int, asked: int) -> LimitExceeded:
    text = f"{what.format(limit=limit)}, but this one has {asked}"
    return LimitExceeded(text, field="Upload-Length", limit=limit, asked=asked)
