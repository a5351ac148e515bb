"""Files on their way in: streamed to disk, resumed where they broke off, within the quota of their user."""

from __future__ import annotations

import asyncio
import os
import shutil
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.map_jobs import Upload
from rce.mapservice.files import Shelf, check_file_name, new_id
from rce.mapservice.kinds import HEAD, check_head, suffix_of
from rce.metrics import Counter

PIECE = 4 * 1024 * 1024  # bytes that are written at once
DAY = 86_400.0
FILES_MOST = 1000  # of one user: also small ones take room
UNFINISHED = DAY  # seconds that an upload may rest

_received = Counter("rce_map_upload_bytes", "Bytes of recordings that have come")


class Limits(Struct, frozen=True):
    """Bytes of one file, bytes of one user, and bytes of the disk that stay free; seconds for which files are kept."""

    file: int
    user: int
    spare: int
    keep: float


class Stored(Struct, frozen=True):
    """An upload as it is kept. `used`: when it was last written to, or taken by a job."""

    user: str
    name: str
    length: int
    used: float
    fingerprint: str = ""


class OffsetMismatch(InvalidRequest):
    """The client continues at another place than the file ends at; it may ask where that is."""

    code = "offset_mismatch"


class Uploads:
    """All uploads. `results` tells how many bytes of a user's quota their results take; `now` is the wall clock."""

    def __init__(
        self, directory: Path, limits: Limits, results: Callable[[str], int], now: Callable[[], float] = time.time
    ) -> None:
        self._shelf = Shelf(directory, Stored)
        self._limits = limits
        self._results = results
        self._now = now
        self._stored = self._shelf.load()
        self._writers: dict[str, asyncio.Task[object]] = {}

    @property
    def largest(self) -> int:
        return self._limits.file

    def create(self, user: str, name: str, length: int, fingerprint: str = "") -> Upload:
        """InvalidRequest for a name that is no recording's, LimitExceeded for more than there is room for."""
        suffix_of(check_file_name(name, "Upload-Metadata.filename"))
        if length < 1:
            raise InvalidRequest(f"{name} is empty", field="Upload-Length")
        if length > self._limits.file:
            raise _exceeded("a file may have", self._limits.file, length)
        if len(self.of(user)) >= FILES_MOST:
            text = f"you have {FILES_MOST} files here already: remove some that you do not need"
            raise LimitExceeded(text, limit=FILES_MOST)
        used = self.used(user)
        if used + length > self._limits.user:
            raise _exceeded(f"you have {used} bytes here already; all your files may have", self._limits.user, length)
        free = shutil.disk_usage(self._shelf.directory).free - sum(self._missing(each) for each in self._stored)
        if length > free - self._limits.spare:
            raise _exceeded("the disk of the map service has room for", max(0, free - self._limits.spare), length)
        upload, stored = new_id(), Stored(user, name, length, self._now(), fingerprint[:128])
        place = self._shelf.place(upload)
        try:
            place.mkdir(mode=0o700)
            (place / name).touch(mode=0o600)
            self._shelf.put(upload, stored)
        except OSError:
            shutil.rmtree(place, ignore_errors=True)
            raise
        self._stored[upload] = stored
        return self.get(user, upload)

    def check_quota(self, user: str) -> None:
        """LimitExceeded if there is no room for more results of this user."""
        used = self.used(user)
        if used >= self._limits.user:
            text = f"you have {used} bytes here, and may have {self._limits.user}: remove jobs or uploads"
            raise LimitExceeded(text, limit=self._limits.user)

    def get(self, user: str, upload: str, field: str = "") -> Upload:
        """NotFound also for another user's."""
        stored = self._stored.get(upload)
        if stored is None or stored.user != user:
            raise NotFound(f"there is no upload {upload[:64]}; it may have expired", field=field)
        expires = stored.used + (UNFINISHED if self._missing(upload) else self._limits.keep)
        return Upload(upload, stored.name, stored.length, self.offset(upload), expires, stored.fingerprint)

    def of(self, user: str) -> list[Upload]:
        return [self.get(user, upload) for upload, stored in self._stored.items() if stored.user == user]

    def used(self, user: str) -> int:
        """Bytes of a user's quota that are taken, those that are yet to come included."""
        return sum(stored.length for stored in self._stored.values() if stored.user == user) + self._results(user)

    def path(self, upload: str) -> Path:
        return self._shelf.place(upload) / self._stored[upload].name

    def offset(self, upload: str) -> int:
        return self.path(upload).stat().st_size

    def _missing(self, upload: str) -> int:
        return self._stored[upload].length - self.offset(upload)

    async def append(self, user: str, upload: str, offset: int, pieces: AsyncIterator[bytes]) -> Upload:
        """Add what comes. What has come is kept when it breaks off; a later call takes over from one that hangs."""
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
                    f"{found.name} has {found.offset} bytes so far, so it continues there and not at {offset}",
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
                await writer.take(piece)
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
                check_head(upload.name, _head(self.path(upload.id)))  # shorter than HEAD: nobody has looked yet
            except InvalidRequest:
                await self._drop(upload.id)
                raise

    def touch(self, upload: str) -> None:
        """It is in use: its time to live begins again."""
        self._stored[upload] = replace(self._stored[upload], used=self._now())
        self._shelf.put(upload, self._stored[upload])

    async def remove(self, user: str, upload: str) -> None:
        self.get(user, upload)
        writer = self._writers.get(upload)
        if writer is not None:
            writer.cancel()
            await asyncio.wait({writer})
        await self._drop(upload)

    async def _drop(self, upload: str) -> None:
        self._stored.pop(upload, None)
        await asyncio.to_thread(shutil.rmtree, self._shelf.place(upload), True)

    async def sweep(self, in_use: Callable[[str], bool]) -> None:
        """Remove what has expired."""
        for upload, stored in list(self._stored.items()):
            expired = self.get(stored.user, upload).expires < self._now()
            if expired and upload not in self._writers and not in_use(upload):
                await self._drop(upload)


class _Writer:
    """Puts pieces together to larger ones and writes those in a thread, one while the next comes in."""

    def __init__(self, path: Path, upload: Upload) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND)
        self._name = upload.name
        self._room = upload.length - upload.offset
        self._head: bytearray | None = bytearray(_head(path)) if upload.offset < HEAD else None
        self._pieces: list[bytes] = []
        self._size = 0
        self._write: asyncio.Future[None] | None = None

    async def take(self, piece: bytes) -> None:
        self._room -= len(piece)
        if self._room < 0:
            raise InvalidRequest(f"{self._name} has more bytes than its Upload-Length says", field="Upload-Length")
        if self._head is not None:
            self._head += piece[:HEAD]
            if len(self._head) >= HEAD:
                check_head(self._name, bytes(self._head[:HEAD]))
                self._head = None
        _received.add(by=len(piece))
        self._pieces.append(piece)
        self._size += len(piece)
        if self._size >= PIECE:
            await self._flush()

    async def _flush(self) -> None:
        pieces, self._pieces, self._size = self._pieces, [], 0
        if self._write is not None:
            await asyncio.shield(self._write)
        self._write = asyncio.get_running_loop().run_in_executor(None, _write_all, self._file, pieces)

    async def close(self, keep: bool = True) -> None:
        """Write what is left, also when this is cancelled: the file may only end where its writes do."""
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
    if written < size:  # a disk that is nearly full; the next write says so
        rest = memoryview(b"".join(pieces))[written:]
        while rest:
            rest = rest[os.write(file, rest) :]


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD)


def _exceeded(what: str, limit: int, asked: int) -> LimitExceeded:
    text = f"{what} {limit} bytes at most, and this one has {asked}"
    return LimitExceeded(text, field="Upload-Length", limit=limit, asked=asked)
