"""Files of entries on the disk, each once under the SHA-256 of its content."""

from __future__ import annotations

import asyncio
import hashlib
import os
import shutil
from collections.abc import AsyncIterator, Iterable
from pathlib import Path
from typing import BinaryIO

from msgspec import Struct

from rce.errors import DiskFull, LimitExceeded

DRAFTS = "drafts"


class Received(Struct, frozen=True):
    """A file that has come and is not kept yet."""

    path: Path
    size: int
    sha256: str


class Contents:
    """The directory of the files."""

    def __init__(self, directory: Path, largest: int, spare: int) -> None:
        """Create the directory if it is missing, and remove what never came to its end.

        Args:
            directory: The directory.
            largest: Bytes that a file may have.
            spare: Bytes of the disk that stay free.
        """
        self._directory = directory
        self._drafts = directory / DRAFTS
        self._largest = largest
        self._spare = spare
        shutil.rmtree(self._drafts, ignore_errors=True)
        self._drafts.mkdir(parents=True, mode=0o700)

    def path(self, digest: str) -> Path:
        """Return the path of a file that is kept."""
        return self._directory / digest[:2] / digest

    def draft(self) -> Path:
        """Return a path for a file that is being made, which is removed at the next start if nobody removes it."""
        return self._drafts / os.urandom(12).hex()

    async def receive(self, pieces: AsyncIterator[bytes]) -> Received:
        """Write a file as it comes.

        Raises:
            LimitExceeded: It is larger than it may be.
            DiskFull: There is no room on the disk.
        """
        path = self.draft()
        digest, size = hashlib.sha256(), 0
        try:
            with path.open("wb") as out:  # pieces are written in a thread
                async for piece in pieces:
                    self.check_space()
                    size += len(piece)
                    if size > self._largest:
                        text = f"a file may have {self._largest} bytes"
                        raise LimitExceeded(text, limit=self._largest, field="file")
                    await asyncio.to_thread(_append, out, piece)
                    digest.update(piece)
                await asyncio.to_thread(flush, out)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        return Received(path, size, digest.hexdigest())

    def check_space(self) -> None:
        """Check that there is room on the disk.

        Raises:
            DiskFull: The disk is full but for what must stay free.
        """
        if shutil.disk_usage(self._directory).free < self._spare:
            raise DiskFull("disk full (knowledge service): an administrator must make room; then retry")

    def keep(self, received: Received) -> None:
        """Keep a file that has come, also if the power fails afterwards."""
        path = self.path(received.sha256)
        path.parent.mkdir(exist_ok=True, mode=0o700)
        received.path.replace(path)
        for directory in (path.parent, self._directory):
            _flush_directory(directory)

    def discard(self, received: Received) -> None:
        """Remove a file that has come, unless it is kept."""
        received.path.unlink(missing_ok=True)

    def remove(self, digests: Iterable[str]) -> None:
        """Remove files."""
        for digest in digests:
            self.path(digest).unlink(missing_ok=True)

    def sweep(self, known: set[str]) -> None:
        """Remove the files that are not known, as a process leaves them that dies in the middle of a change."""
        for path in self._directory.glob("??/*"):
            if path.name not in known:
                path.unlink(missing_ok=True)


def flush(file: BinaryIO) -> None:
    """Write what a file has to the disk."""
    file.flush()
    os.fsync(file.fileno())


def _flush_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _append(out: BinaryIO, piece: bytes) -> None:
    out.write(piece)
