"""The output of a node, in two files that do not grow without limit: the newest, and what came before it."""

from __future__ import annotations

from pathlib import Path

MOST = 1_000_000  # bytes at which a new file begins
LONGEST_LINE = 1000


class NodeLog:
    """Bytes go in as they come; the last lines come out."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._older = path.with_name(path.name + ".1")
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

    def last_lines(self, count: int) -> list[str]:
        """At most `count` lines, each cut to LONGEST_LINE characters."""
        most = count * LONGEST_LINE
        end = _end(self._path, most)
        if len(end) < most and self._older.exists():
            end = _end(self._older, most - len(end)) + end
        return [line[:LONGEST_LINE] for line in end.decode(errors="replace").splitlines()[-count:]] if count else []

    def close(self) -> None:
        self._file.close()


def _end(path: Path, most: int) -> bytes:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - most))
        return file.read(most)
