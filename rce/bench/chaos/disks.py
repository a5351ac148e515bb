"""Directories in memory of limited size, as disks that can be filled."""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

MEGABYTE = 1_000_000
TOP_UP_INTERVAL = 0.05  # seconds after which room that a process has made meanwhile is filled, too
FILLER = "filler"
BLOCK = 4096  # bytes, of the file system


class Disk:
    """A file system in memory, mounted on a directory."""

    def __init__(self, directory: Path, size: int) -> None:
        """Use a directory on which a file system of this size is mounted."""
        self._path = directory / FILLER
        self._size = size
        self._file: int | None = None
        self._filling: asyncio.Task[None] | None = None

    def fill(self) -> None:
        """Leave no room until `free`."""
        # Held open, so that nothing is ever written to the disk below once this one is unmounted.
        self._file = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        self._take_all(self._file)
        self._filling = asyncio.create_task(self._top_up(self._file))

    async def free(self) -> None:
        """Give the room back."""
        if self._filling is not None:
            self._filling.cancel()
            await asyncio.gather(self._filling, return_exceptions=True)
        self.close()
        self._path.unlink(missing_ok=True)

    def close(self) -> None:
        """Fill no more."""
        if self._filling is not None:
            self._filling.cancel()
        if self._file is not None:
            os.close(self._file)
            self._file = None

    async def _top_up(self, file: int) -> None:
        while True:
            await asyncio.sleep(TOP_UP_INTERVAL)
            self._take_all(file)

    def _take_all(self, file: int) -> None:
        """Extend a file until the disk has no room, and never beyond the size of the disk."""
        for size in (MEGABYTE, BLOCK):
            with contextlib.suppress(OSError):  # no room for that much
                while os.fstat(file).st_size < self._size:
                    os.write(file, bytes(size))


@contextlib.contextmanager
def mounted(sizes: dict[Path, int]) -> Iterator[dict[Path, Disk]]:
    """Mount file systems in memory of these sizes in bytes; none where that is not permitted."""
    disks: dict[Path, Disk] = {}
    try:
        for directory, size in sizes.items():
            directory.mkdir(parents=True, exist_ok=True, mode=0o700)
            if _mount(directory, size):
                disks[directory] = Disk(directory, size)
        yield disks
    finally:
        for directory, disk in disks.items():
            disk.close()
            subprocess.run(["umount", "--lazy", directory], check=False)


def _mount(directory: Path, size: int) -> bool:
    options = f"size={size},mode=0700"
    command = ["mount", "-t", "tmpfs", "-o", options, "rce-chaos", str(directory)]
    return os.geteuid() == 0 and subprocess.run(command, check=False, capture_output=True).returncode == 0
