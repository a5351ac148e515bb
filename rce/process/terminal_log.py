"""Log of `rce up` at a terminal: what concerns the user is printed as text, and everything is kept in a file."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import msgspec
from msgspec import Struct

SHOWN = ("warn", "error", "critical")
MAX_SIZE = 10_000_000  # bytes of the file; one older file is kept
END_TIMEOUT = 5.0  # seconds to write what the processes have logged last


class _Entry(Struct):
    """Line of a log."""

    time: str
    level: str
    message: str


@contextlib.contextmanager
def terminal_log(path: Path, terminal: IO[str] = sys.stderr) -> Iterator[IO[str]]:
    """Open a log whose lines go to a file, and those that concern the user to the terminal, too."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    reading, writing = os.pipe()
    copier = threading.Thread(target=_copy, args=(reading, path, terminal), name="log", daemon=True)
    copier.start()
    with os.fdopen(writing, "w", buffering=1) as log:
        yield log
    copier.join(END_TIMEOUT)


def shown_text(line: str) -> str:
    """Return what a line of the log tells the user, or nothing."""
    try:
        entry = msgspec.json.decode(line, type=_Entry)
    except msgspec.DecodeError:  # not of a process: of `rce up` itself, or a traceback
        return line.rstrip("\n")
    return f"{entry.time[11:19]} {entry.level}: {entry.message}" if entry.level in SHOWN else ""


def _copy(reading: int, path: Path, terminal: IO[str]) -> None:
    with os.fdopen(reading, errors="replace") as lines, contextlib.ExitStack() as stack:
        file = stack.enter_context(path.open("w"))
        for line in lines:
            with contextlib.suppress(OSError):  # as of a full disk, of which the processes tell themselves
                if file.tell() > MAX_SIZE:
                    file.close()
                    path.replace(path.with_name(f"{path.name}.1"))
                    file = stack.enter_context(path.open("w"))
                file.write(line)
                file.flush()
            if text := shown_text(line):
                print(text, file=terminal, flush=True)
