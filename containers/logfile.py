"""Log files that other processes append to: their last lines, and a bound on their size.

The writer appends to an open file (O_APPEND), so it needs no pipe, which would break with the task set's end, and the
file can be cut under it: what it writes next goes to the new end.
"""

from __future__ import annotations

import os
from pathlib import Path

MOST = 1_000_000  # bytes; the older half of that is kept in a second file beside
LONGEST_LINE = 1000


def older(log: Path) -> Path:
    """Where `trim` puts what it cuts off."""
    return log.with_name(log.name + ".1")


def trim(log: Path) -> None:
    """Keep a log and its older part below twice MOST; what is written during the cut may be lost."""
    try:
        with log.open("r+b") as file:
            size = file.seek(0, os.SEEK_END)
            if size > MOST:
                file.seek(size - MOST // 2)
                older(log).write_bytes(file.read(MOST))
                file.truncate(0)
    except FileNotFoundError:
        pass  # the environment went meanwhile


def last_lines(log: Path, count: int) -> list[str]:
    """The last lines of a log, cut to LONGEST_LINE characters; none where there is no log."""
    text = b"".join(_end(path, count * LONGEST_LINE) for path in (older(log), log))
    return [line[:LONGEST_LINE] for line in text.decode(errors="replace").splitlines()[-count:]]


def _end(path: Path, most: int) -> bytes:
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - most))
            return file.read(most)
    except FileNotFoundError:
        return b""
