"""The archives of users' packages on the Master's disk, by their digests, and their way in and out.

An upload is announced first (its user, digest and size are checked against the quota), and what then comes in with the
ticket, of that very size, goes straight to disk. So nobody fills disk or memory without having been let in.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import tempfile
from pathlib import Path

from msgspec import Struct
from twisted.logger import Logger

from master.tickets import Tickets
from rce import archive
from rce.archive import MAX_BYTES, Contents
from rce.errors import InvalidRequest, LimitExceeded, NotFound

UPLOAD_SECONDS, FETCH_SECONDS = 300.0, 60.0  # from ticket to the beginning of the body
UPLOAD_PATH, FETCH_PATH = "/api/v1/uploads", "/api/v1/archives"
UPLOADS_AT_ONCE = 4  # of one user

log = Logger()


class Announced(Struct, frozen=True):
    """An upload to come."""

    user: str
    name: str
    digest: str
    size: int


class Upload:
    """The body of a request as it comes in: to Twisted a file. What is not kept is gone when it is closed."""

    def __init__(self, depot: Depot, announced: Announced) -> None:
        self.announced = announced
        self._depot = depot
        self._hash = hashlib.sha256()
        self._size = 0
        descriptor, path = tempfile.mkstemp(dir=depot.incoming)
        self._file = os.fdopen(descriptor, "wb")
        self.path = Path(path)
        depot.running.add(self)

    def write(self, data: bytes) -> int:
        self._size += len(data)
        self._hash.update(data)
        return self._file.write(data)

    def tell(self) -> int:
        return self._size

    def seek(self, offset: int, whence: int = 0) -> int:
        """Twisted rewinds what it has written, and reads it if it takes it for a form; this is not read through it."""
        return 0

    def read(self) -> bytes:
        return b""

    def close(self) -> None:
        self._depot.running.discard(self)
        self._file.close()
        self.path.unlink(missing_ok=True)

    async def check(self) -> Contents:
        """Is it what was announced, and an archive? InvalidRequest, LimitExceeded."""
        self._file.close()
        if self._hash.hexdigest() != self.announced.digest:
            raise InvalidRequest(f"what came in does not have the SHA-256 {self.announced.digest}: push it again")
        return await asyncio.to_thread(_inspect, self.path)


class Depot:
    """Archives in `directory`."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self.incoming = directory / "incoming"
        self.running: set[Upload] = set()
        self._uploads: Tickets[Announced] = Tickets(UPLOAD_SECONDS)
        self._fetches: Tickets[Path] = Tickets(FETCH_SECONDS)
        self.incoming.mkdir(parents=True, exist_ok=True, mode=0o700)
        for path in self.incoming.iterdir():
            path.unlink()  # uploads that a Master before this one did not finish

    def announce(self, announced: Announced) -> str:
        """The token for an upload. InvalidRequest, LimitExceeded."""
        if not archive.DIGEST.fullmatch(announced.digest):
            raise InvalidRequest(f"digest {announced.digest[:80]!r} is not a SHA-256 in hex", field="digest")
        if not 0 < announced.size <= MAX_BYTES:
            raise LimitExceeded(f"an archive has 1 to {MAX_BYTES} bytes", field="size", limit=MAX_BYTES)
        if sum(each.user == announced.user for each in self.pending()) >= UPLOADS_AT_ONCE:
            raise LimitExceeded(
                f"{UPLOADS_AT_ONCE} uploads of yours are under way or announced; wait for one to end",
                limit=UPLOADS_AT_ONCE,
            )
        return self._uploads.issue(announced)

    def pending(self) -> list[Announced]:
        """Announced or under way."""
        return [*self._uploads.outstanding(), *(upload.announced for upload in self.running)]

    def begin(self, token: str, length: int | None) -> Upload | None:
        """The upload of this token, if there is one and it is to have this many bytes."""
        announced = self._uploads.take(token)
        return None if announced is None or announced.size != length else Upload(self, announced)

    def keep(self, upload: Upload) -> None:
        """A checked upload becomes an archive; the caller names it in the records before it waits for anything."""
        upload.path.chmod(0o400)
        upload.path.rename(self._directory / upload.announced.digest)

    def ticket(self, digest: str) -> tuple[str, int]:
        """The token with which an archive is fetched, and its size. NotFound."""
        path = self._directory / digest
        if not archive.DIGEST.fullmatch(digest) or not path.is_file():
            raise NotFound(f"there is no archive {digest[:80]}")
        return self._fetches.issue(path), path.stat().st_size

    def fetch(self, token: str) -> Path | None:
        """The archive of this token, if it is one."""
        return self._fetches.take(token)

    def sweep(self, named: set[str]) -> None:
        """Remove the archives that are not named."""
        for path in self._directory.iterdir():
            if archive.DIGEST.fullmatch(path.name) and path.name not in named:
                with contextlib.suppress(FileNotFoundError):
                    path.unlink()
                log.info("archive {digest} is not named any more: removed", digest=path.name)


def _inspect(path: Path) -> Contents:
    with path.open("rb") as file:
        return archive.inspect(file)
