"""Log files that other processes append to: reading their last lines and bounding their size.

The writer opens the file with O_APPEND. Unlike a pipe, the file survives the end of the task set, and it can be
truncated while the writer has it open: the next write goes to the new end.
"""

from __future__ import annotations

import os
from pathlib import Path

MAX_SIZE = 1_000_000  # bytes, from which on the file is cut; its newest half is then kept in a second file
LONGEST_LINE = 1000


def older(log: Path) -> Path:
    """Return the path of the file to which `trim` moves output."""
    return log.with_name(log.name + ".1")


def trim(log: Path) -> None:
    """Keep a log and its older part below twice MAX_SIZE; lines written during the cut may be lost."""
    try:
        with log.open("r+b") as file:
            size = file.seek(0, os.SEEK_END)
            if size > MAX_SIZE:
                file.seek(size - MAX_SIZE // 2)
                older(log).write_bytes(file.read(MAX_SIZE))
                file.truncate(0)
    except FileNotFoundError:
        pass  # the environment was removed meanwhile


def last_lines(log: Path, count: int) -> list[str]:
    """Return the last lines of a log, each cut to LONGEST_LINE characters; none if there is no log."""
    text = b"".join(_end(path, count * LONGEST_LINE) for path in (older(log), log))
    return [line[:LONGEST_LINE] for line in text.decode(errors="replace").splitlines()[-count:]]


def _end(path: Path, size: int) -> bytes:
    """Return the last `size` bytes of a file."""
    try:
        with path.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - size))
            return file.read(size)
    except FileNotFoundError:
        return b""
