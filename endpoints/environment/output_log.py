"""Log of a process's output, in two files of bounded size: the current one and the one before it."""

from __future__ import annotations

import asyncio
import secrets
from contextlib import suppress
from pathlib import Path

from rce.errors import describe_os_error

MAX_FILE_SIZE = 1_000_000  # bytes after which a new file begins
MAX_READ = 65_536  # bytes that one call of `since` reads
MAX_LINE_LENGTH = 1000
MAX_LAST = 300_000  # bytes that `last_lines` reads; a control message of an environment has 1 MiB


class OutputLog:
    """Log to which output is appended, and of which the last lines, or those after a position, can be read.

    A position like `5f3a-1234` names an instance of the log and the number of bytes before it.
    """

    def __init__(self, path: Path) -> None:
        """Begin a new log at `path`; a file that is there becomes the older one."""
        self._path = path
        self._older = path.with_name(path.name + ".1")
        self._instance = secrets.token_hex(4)
        self._written = 0  # bytes written to this instance
        self._lost = 0  # bytes that could not be written, until there is room for a note of them
        self._reason = ""
        self._changed = asyncio.Event()
        self._closed = False
        self._begin_file()

    def _begin_file(self) -> None:
        if self._path.exists():
            self._path.rename(self._older)
        try:
            self._file = self._path.open("wb", buffering=0)
        except OSError:
            if self._older.exists():
                self._older.rename(self._path)
            raise
        self._size = 0

    def write(self, output: bytes) -> None:
        """Append output. What cannot be written, as on a full disk, is counted, and noted when there is room again."""
        rest = memoryview(output)
        try:
            if self._size >= MAX_FILE_SIZE:
                full = self._file
                self._begin_file()
                full.close()
            note = f"\n[{self._lost} bytes of output are missing: {self._reason}]\n".encode()
            if self._lost and self._append(note) == len(note):
                self._lost = 0
            while rest:
                rest = rest[self._append(rest) :]
        except OSError as error:
            self._lost += len(rest)
            self._reason = describe_os_error(error)
        self._changed.set()

    def _append(self, part: bytes | memoryview) -> int:
        count = self._file.write(part)
        self._size += count
        self._written += count
        return count

    @property
    def end(self) -> str:
        """Position after the last byte."""
        return f"{self._instance}-{self._written}"

    def last_lines(self, count: int) -> list[str]:
        """Return the last `count` lines at most, of the last MAX_LAST bytes, each cut to MAX_LINE_LENGTH characters."""
        most = min(count * MAX_LINE_LENGTH, MAX_LAST)
        end = _read(self._path, max(0, self._size - most), most)
        if len(end) < most and self._older.exists():
            missing = most - len(end)
            end = _read(self._older, max(0, self._older.stat().st_size - missing), missing) + end
        return _lines(end)[-count:] if count else []

    def since(self, position: str) -> tuple[list[str], str]:
        """Return complete lines after `position`, and the position after them.

        A position of another instance counts as the beginning of this one. An incomplete last line is returned only
        when the log is closed, or when the line alone exceeds MAX_READ.
        """
        instance, _, number = position.partition("-")
        start = int(number) if instance == self._instance and number.isdecimal() else 0
        here = self._written - self._size  # where the current file begins
        if start >= here:
            found = _read(self._path, min(start, self._written) - here, MAX_READ)
        else:  # the older file ends where the current one begins; earlier bytes are gone
            size = self._older.stat().st_size if self._older.exists() else 0
            start = max(start, here - size)
            found = _read(self._older, start - here + size, MAX_READ) if size else b""
            if len(found) < MAX_READ:
                found += _read(self._path, 0, MAX_READ - len(found))
        if not self._closed or len(found) == MAX_READ:
            found = found[: found.rfind(b"\n") + 1] or (found if len(found) == MAX_READ else b"")
        return _lines(found), f"{self._instance}-{start + len(found)}"

    async def wait_since(self, position: str, seconds: float) -> tuple[list[str], str]:
        """Like `since`, but wait up to `seconds` until there are lines to return."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while not (found := self.since(position))[0]:
                    self._changed.clear()
                    await self._changed.wait()
                return found
        return self.since(position)

    def close(self) -> None:
        """Close the file; the log can still be read."""
        self._file.close()
        self._closed = True
        self._changed.set()  # an incomplete last line is returned from now on


def _lines(text: bytes) -> list[str]:
    return [line[:MAX_LINE_LENGTH] for line in text.decode(errors="replace").splitlines()]


def _read(path: Path, start: int, size: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        return file.read(size)
