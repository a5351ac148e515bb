"""Depot: archives of users' packages on the Master's disk, by their digests.

With several Masters the archives are in the database too, and the disk of each Master has those that it needed.

An upload is announced first: user, digest and size are checked against the quota. The body that then comes with the
ticket must have that size, and goes straight to disk. So nobody fills disk or memory without permission.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
import shutil
import tempfile
import time
from pathlib import Path

import msgspec
from msgspec import Struct
from twisted.logger import Logger

from master.access.tickets import Tickets
from master.storage.archives import Archives
from rce.errors import InvalidRequest, LimitExceeded, NotFound
from rce.packages import archive
from rce.packages.archive import MAX_BYTES, Contents

UPLOAD_SECONDS, FETCH_SECONDS = 300.0, 60.0  # validity of tickets
UPLOAD_PATH, FETCH_PATH = "/api/v1/uploads", "/api/v1/archives"
UPLOADS_AT_ONCE = 4  # of one user

log = Logger()


class AnnouncedUpload(Struct, frozen=True):
    """An upload that was checked and may begin."""

    user: str
    name: str
    digest: str
    size: int
    time: float = msgspec.field(default_factory=time.time)  # when it was checked


class Upload:
    """File to which an upload is written; `close` removes it unless it was kept."""

    def __init__(self, depot: Depot, announced: AnnouncedUpload) -> None:
        self.announced = announced
        self._depot = depot
        self._hash = hashlib.sha256()
        descriptor, path = tempfile.mkstemp(dir=depot.incoming)
        self._file = os.fdopen(descriptor, "wb")
        self.path = Path(path)
        depot.running.add(self)

    def write(self, data: bytes) -> None:
        """Append bytes to the file."""
        self._hash.update(data)
        self._file.write(data)

    def close(self) -> None:
        """Close the file, and remove it unless it was kept."""
        self._depot.running.discard(self)
        with contextlib.suppress(OSError):  # a full disk: what is still in the buffer is not wanted any more
            self._file.close()
        self.path.unlink(missing_ok=True)

    async def check(self) -> Contents:
        """Check that the body is what was announced, and read it as an archive.

        Raises:
            InvalidRequest: It has another digest, or is no archive.
            LimitExceeded: It is too large unpacked.
        """
        self._file.close()
        if self._hash.hexdigest() != self.announced.digest:
            raise InvalidRequest(f"the upload does not have the SHA-256 {self.announced.digest}: push it again")
        return await asyncio.to_thread(_inspect, self.path)


class Depot:
    """Archives in `directory`, and in the database if there are `archives`."""

    def __init__(self, directory: Path, archives: Archives | None = None) -> None:
        self._directory = directory
        self._archives = archives
        self.incoming = directory / "incoming"
        self.running: set[Upload] = set()
        self._uploads: Tickets[AnnouncedUpload] = Tickets(UPLOAD_SECONDS)
        self._fetches: Tickets[Path] = Tickets(FETCH_SECONDS)
        self.incoming.mkdir(parents=True, exist_ok=True, mode=0o700)
        for path in self.incoming.iterdir():  # unfinished uploads and downloads of an earlier Master
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    def announce(self, announced: AnnouncedUpload) -> str:
        """Issue the ticket of an upload.

        Raises:
            InvalidRequest: The digest is malformed.
            LimitExceeded: It is too large, or the user has too many uploads.
        """
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

    def pending(self) -> list[AnnouncedUpload]:
        """Return uploads that are announced or running."""
        return [*self._uploads.outstanding(), *(upload.announced for upload in self.running)]

    def begin(self, token: str, length: int | None) -> Upload | None:
        """Begin the upload of a ticket, if it is valid and for this many bytes."""
        announced = self._uploads.take(token)
        return None if announced is None or announced.size != length else Upload(self, announced)

    async def store(self, upload: Upload) -> None:
        """Store a checked upload where other Masters find it."""
        if self._archives is not None:
            await self._archives.put(upload.announced.digest, upload.path)

    def keep(self, upload: Upload) -> None:
        """Turn a checked upload into an archive. The caller must add it to the records before anything else can run."""
        self._place(upload.path, upload.announced.digest)

    def _place(self, path: Path, digest: str) -> None:
        path.chmod(0o400)
        path.rename(self._directory / digest)

    async def provide(self, digest: str) -> None:
        """Fetch an archive that another Master stored, unless it is on this disk.

        Raises:
            NotFound: There is no such archive.
        """
        if self._archives is None or not archive.DIGEST.fullmatch(digest) or (self._directory / digest).is_file():
            return
        with tempfile.TemporaryDirectory(dir=self.incoming) as incoming:
            path = Path(incoming) / digest
            await self._archives.fetch(digest, path)
            self._place(path, digest)

    async def adopt(self, named: set[str]) -> None:
        """Store archives of this disk that the database lacks: of a restored backup, or of a Master that was alone."""
        if self._archives is None:
            return
        for digest in sorted(named - await self._archives.digests()):
            if (self._directory / digest).is_file():
                await self._archives.put(digest, self._directory / digest)

    def ticket(self, digest: str) -> tuple[str, int]:
        """Issue a ticket to fetch an archive; return it and the size.

        Raises:
            NotFound: There is no such archive.
        """
        path = self._directory / digest
        if not archive.DIGEST.fullmatch(digest) or not path.is_file():
            raise NotFound(f"there is no archive {digest[:80]}")
        return self._fetches.issue(path), path.stat().st_size

    def fetch(self, token: str) -> Path | None:
        """Redeem the ticket of an archive."""
        return self._fetches.take(token)

    def sweep(self, named: set[str]) -> None:
        """Remove the archives whose digests are not in `named`."""
        for path in self._directory.iterdir():
            if archive.DIGEST.fullmatch(path.name) and path.name not in named:
                with contextlib.suppress(FileNotFoundError):
                    path.unlink()
                log.info("removed archive {digest}, which is not used any more", digest=path.name)

    async def sweep_database(self, named: set[str]) -> None:
        """Remove the archives from the database whose digests are not in `named`, nor those of uploads."""
        if self._archives is not None:
            await self._archives.keep_only(named | {each.digest for each in self.pending()})


def _inspect(path: Path) -> Contents:
    with path.open("rb") as file:
        return archive.inspect(file)
