"""Store of recordings: files of users within their quotas, which are appended to, read and removed."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct
from msgspec.structs import replace

from rce.control.calls.recordings import PIECE, RecordingInfo, RecordingQuota, RecordingState
from rce.errors import DiskFull, InvalidRequest, LimitExceeded, NotFound
from rce.services.record_store import RecordStore, check_file_name, new_id

MAGIC = b"\x89MCAP0\r\n"
SUFFIX = ".mcap"
MAX_FILES = 1000  # of one user on one machine
MAX_NAME = 60  # characters of a tag in the name of a file
ABANDONED = 24 * 3600.0  # seconds without data after which an upload is removed
SPARE = 1_000_000_000  # bytes of the disk that stay free


class OffsetMismatch(InvalidRequest):
    """The client continues at another offset than the end of the file; `fields` has the right offset."""

    code = "offset_mismatch"


class StoredRecording(Struct, frozen=True):
    """Record of a recording; see `RecordingInfo`."""

    user: str
    name: str
    state: RecordingState
    created: float
    environment: str = ""
    recorder: str = ""
    length: int = 0
    fingerprint: str = ""


class OpenRecording:
    """Recording of an environment that grows; `write` is called by one thread."""

    def __init__(self, store: RecordingStore, id: str, quota: RecordingQuota) -> None:
        self.id = id
        self._store = store
        self._quota = quota
        self._file = store.path(id).open("ab", buffering=0)

    def write(self, data: bytes | memoryview) -> None:
        """Append bytes.

        Raises:
            LimitExceeded: The quota of the user is used up.
            DiskFull: There is no room.
            NotFound: The recording was removed.
        """
        self._store.take(self.id, len(data), self._quota)
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]

    def end(self) -> None:
        """Close the file; without the end of an MCAP file it is cut off."""
        self._file.close()
        self._store.settle(self.id)


class RecordingStore:
    """Recordings in a directory. `write` of open recordings comes from threads, all else from one."""

    def __init__(self, directory: Path, spare: int = SPARE, now: Callable[[], float] = time.time) -> None:
        """Load what an earlier task set left; what it was writing is cut off.

        Args:
            directory: Directory of the recordings.
            spare: Bytes of the disk that stay free.
            now: The wall clock.
        """
        self.directory = directory
        self._records = RecordStore(directory, StoredRecording)
        self._spare = spare
        self._now = now
        self._lock = threading.RLock()
        self._stored = self._records.load()
        self._sizes: dict[str, int] = {}
        self._open: dict[str, OpenRecording] = {}
        for id, stored in list(self._stored.items()):
            if not self.path(id).exists():  # it was being removed
                self._drop(id)
                continue
            self._sizes[id] = self.path(id).stat().st_size
            if stored.state == "recording":
                self.settle(id)

    def path(self, id: str) -> Path:
        """Return the path of a file."""
        return self._records.path(id) / self._stored[id].name

    def begin(self, environment: str, recorder: str, quota: RecordingQuota) -> OpenRecording:
        """Begin a recording of an environment, `user/tag`.

        Raises:
            LimitExceeded: The quota of the user is used up, or they have too many files.
            DiskFull: There is no room.
        """
        user, _, tag = environment.partition("/")
        when = time.strftime("%Y%m%d-%H%M%S", time.gmtime(self._now()))
        name = f"{tag[:MAX_NAME]}-{recorder[:MAX_NAME]}-{when}{SUFFIX}"
        id = self._add(StoredRecording(user, name, "recording", self._now(), tag, recorder))
        try:
            self.take(id, 0, quota)
            self._open[id] = OpenRecording(self, id, quota)
        except BaseException:
            self._drop(id)
            raise
        return self._open[id]

    def announce(self, user: str, name: str, length: int, fingerprint: str, quota: RecordingQuota) -> RecordingInfo:
        """Make room for an upload.

        Raises:
            InvalidRequest: It is no MCAP file by its name, or empty.
            LimitExceeded: It is too large for the quota, or the user has too many files.
            DiskFull: There is no room.
        """
        check_file_name(name, "Upload-Metadata.filename")
        if not name.endswith(SUFFIX):
            raise InvalidRequest(f"{name} is not an MCAP file by its name", field="Upload-Metadata.filename")
        if length < 1:
            raise InvalidRequest(f"{name} is empty", field="Upload-Length")
        stored = StoredRecording(user, name, "uploading", self._now(), length=length, fingerprint=fingerprint[:128])
        self._drop_abandoned()
        with self._lock:
            self._check(user, length, quota)
        return self._info(self._add(stored))

    def append(self, user: str, id: str, offset: int, data: bytes) -> RecordingInfo:
        """Append data of an upload. Blocks.

        Raises:
            NotFound: The user has no such upload.
            OffsetMismatch: `offset` is not the end of the file.
            InvalidRequest: There is more data than announced, or it is no MCAP file; the upload is removed.
        """
        with self._lock:
            stored, size = self._find(user, id), self._sizes[id]
            if offset != size or stored.state != "uploading":
                raise OffsetMismatch(f"{stored.name} has {size} bytes so far", field="Upload-Offset", offset=size)
            if not size and not data.startswith(MAGIC):
                self._drop(id)
                raise InvalidRequest(f"{stored.name} is no MCAP file: it begins with {data[:8]!r}", field="body")
            if size + len(data) > stored.length:
                self._drop(id)
                raise InvalidRequest(f"{stored.name} has more bytes than its Upload-Length says", field="body")
            with self.path(id).open("ab") as file:
                file.write(data)
            self._sizes[id] += len(data)
            if self._sizes[id] == stored.length:
                self._set_state(id, "complete")
            return self._info(id)

    def of(self, user: str) -> list[RecordingInfo]:
        """Return the recordings of a user, the newest first."""
        with self._lock:
            found = [self._info(id) for id, stored in self._stored.items() if stored.user == user]
        return sorted(found, key=lambda each: each.created, reverse=True)

    def read(self, user: str, id: str, offset: int, length: int) -> bytes:
        """Return a piece of a recording, empty beyond its end. Blocks.

        Raises:
            NotFound: The user has no such recording.
        """
        with self._lock:
            self._find(user, id)
            file = self.path(id).open("rb")
        with file:
            file.seek(offset)
            return file.read(min(length, PIECE))

    def remove(self, user: str, id: str) -> None:
        """Remove a recording; one that goes on ends.

        Raises:
            NotFound: The user has no such recording.
        """
        with self._lock:
            self._find(user, id)
            self._drop(id)

    def forget(self, user: str) -> None:
        """Remove all recordings of a user who was removed; those that go on end. Blocks."""
        with self._lock:
            found = [id for id, stored in self._stored.items() if stored.user == user]
        for id in found:
            self._drop(id)

    # --- used by open recordings --------------------------------------------------------------------------------------

    def take(self, id: str, size: int, quota: RecordingQuota) -> None:
        """Count bytes that are about to be written."""
        with self._lock:
            if id not in self._stored:
                raise NotFound("the recording was removed while it went on")
            self._check(self._stored[id].user, size, quota)
            self._sizes[id] += size

    def settle(self, id: str) -> None:
        """Note that a recording has ended: it is complete or cut off."""
        with self._lock:
            self._open.pop(id, None)
            if id in self._stored:
                self._set_state(id, "complete" if _has_end(self.path(id)) else "cut off")

    # ------------------------------------------------------------------------------------------------------------------

    def _drop_abandoned(self) -> None:
        """Remove the uploads to which nothing was appended for long: they take the room that they have announced."""
        with self._lock:
            uploads = [id for id, stored in self._stored.items() if stored.state == "uploading"]
            old = [id for id in uploads if self._now() - self._last_change(id) > ABANDONED]
        for id in old:
            self._drop(id)

    def _last_change(self, id: str) -> float:
        return max(self._stored[id].created, self.path(id).stat().st_mtime)

    def _set_state(self, id: str, state: RecordingState) -> None:
        self._stored[id] = replace(self._stored[id], state=state)
        self._records.put(id, self._stored[id])

    def _check(self, user: str, size: int, quota: RecordingQuota) -> None:
        used = sum(max(stored.length, self._sizes[id]) for id, stored in self._stored.items() if stored.user == user)
        if quota.bytes is not None and used + max(1, size) > quota.bytes:
            raise LimitExceeded(
                f"recordings: {used + size} bytes on this machine; yours may have {quota.bytes}: remove some",
                asked=used + size,
                limit=quota.bytes,
            )
        promised = sum(max(0, stored.length - self._sizes[id]) for id, stored in self._stored.items())
        if shutil.disk_usage(self._records.directory).free - promised < self._spare + size:
            raise DiskFull.at("recordings of this machine")

    def _add(self, stored: StoredRecording) -> str:
        if sum(each.user == stored.user for each in self._stored.values()) >= MAX_FILES:
            raise LimitExceeded(f"you have {MAX_FILES} recordings on this machine: remove some", limit=MAX_FILES)
        id = new_id()
        path = self._records.path(id)
        try:
            path.mkdir(mode=0o700)
            (path / stored.name).touch(mode=0o600)
            self._records.put(id, stored)
        except OSError:
            shutil.rmtree(path, ignore_errors=True)
            raise
        with self._lock:
            self._stored[id], self._sizes[id] = stored, 0
        return id

    def _find(self, user: str, id: str) -> StoredRecording:
        stored = self._stored.get(id)
        if stored is None or stored.user != user:
            raise NotFound(f"there is no recording {id[:64]!r} on this machine", field="recording")
        return stored

    def _drop(self, id: str) -> None:
        with self._lock:
            self._stored.pop(id, None)
            self._sizes.pop(id, None)
            self._open.pop(id, None)
        shutil.rmtree(self._records.path(id), ignore_errors=True)

    def _info(self, id: str) -> RecordingInfo:
        each, size = self._stored[id], self._sizes[id]
        return RecordingInfo(
            *(id, each.name, each.state, size, each.created),
            *(each.environment, each.recorder, each.length, each.fingerprint),
        )


def _has_end(path: Path) -> bool:
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(len(MAGIC), size - len(MAGIC)))
        return file.read() == MAGIC
