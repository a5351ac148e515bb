"""The output of a node, in two files that do not grow without limit: the newest, and what came before it."""

from __future__ import annotations

import asyncio
import secrets
from contextlib import suppress
from pathlib import Path

MOST = 1_000_000  # bytes at which a new file begins
AT_ONCE = 65_536  # bytes that are read for one who follows
LONGEST_LINE = 1000


class NodeLog:
    """Bytes go in as they come; the last lines come out, or those after a place that is named like `5f3a-1234`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._older = path.with_name(path.name + ".1")
        self._life = secrets.token_hex(4)
        self._written = 0  # bytes in this life
        self._news = asyncio.Event()
        self._closed = False
        self._begin()

    def _begin(self) -> None:
        if self._path.exists():
            self._path.rename(self._older)
        self._file = self._path.open("wb", buffering=0)
        self._size = 0

    def write(self, output: bytes) -> None:
        if self._size >= MOST:
            self._file.close()
            self._begin()
        self._file.write(output)
        self._size += len(output)
        self._written += len(output)
        self._news.set()

    @property
    def end(self) -> str:
        """The place after all that was written."""
        return f"{self._life}-{self._written}"

    def last_lines(self, count: int) -> list[str]:
        """At most `count` lines, each cut to LONGEST_LINE characters."""
        most = count * LONGEST_LINE
        end = _read(self._path, max(0, self._size - most), most)
        if len(end) < most and self._older.exists():
            missing = most - len(end)
            end = _read(self._older, max(0, self._older.stat().st_size - missing), missing) + end
        return _lines(end)[-count:] if count else []

    def since(self, place: str) -> tuple[list[str], str]:
        """Whole lines after a place, as many as are read at once, and where they end. A place in an earlier life is
        before all of this one's."""
        life, _, number = place.partition("-")
        start = int(number) if life == self._life and number.isdecimal() else 0
        here = self._written - self._size  # where the newest file begins
        if start >= here:
            found = _read(self._path, min(start, self._written) - here, AT_ONCE)
        else:  # the older file has what comes right before, if that is of this life
            size = self._older.stat().st_size
            start = max(start, here - size)
            found = _read(self._older, start - here + size, AT_ONCE)
            if len(found) < AT_ONCE:
                found += _read(self._path, 0, AT_ONCE - len(found))
        if not self._closed or len(found) == AT_ONCE:
            found = found[: found.rfind(b"\n") + 1] or (found if len(found) == AT_ONCE else b"")
        return _lines(found), f"{self._life}-{start + len(found)}"

    async def more(self, place: str, seconds: float) -> tuple[list[str], str]:
        """As `since`, once there is something, or after so long."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                while not (found := self.since(place))[0]:
                    self._news.clear()
                    await self._news.wait()
                return found
        return self.since(place)

    def close(self) -> None:
        self._file.close()
        self._closed = True
        self._news.set()  # a last line without an end counts now


def _lines(text: bytes) -> list[str]:
    return [line[:LONGEST_LINE] for line in text.decode(errors="replace").splitlines()]


def _read(path: Path, start: int, most: int) -> bytes:
    with path.open("rb") as file:
        file.seek(start)
        return file.read(most)
