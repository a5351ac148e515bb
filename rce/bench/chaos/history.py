"""Record of what was done to a platform and what it answered, in the order of time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import IO

import msgspec
from msgspec import Struct


class Entry(Struct, frozen=True):
    """One line of the history.

    Attributes:
        at: Seconds since the beginning.
        who: Robot, or `nemesis`, or `audit`.
        what: Command or fault.
        outcome: What came of it.
    """

    at: float
    who: str
    what: str
    outcome: str

    def __str__(self) -> str:
        return f"{self.at:9.3f}  {self.who:<8}  {self.what}: {self.outcome}"


class History:
    """History that is written to a file line by line, so that it survives this process.

    Attributes:
        entries: All entries.
    """

    def __init__(self, file: Path | None = None) -> None:
        """Begin; without a file the history is kept in memory only."""
        self.entries: list[Entry] = []
        self._began = time.monotonic()
        self._file: IO[bytes] | None = file.open("wb", buffering=0) if file is not None else None

    def add(self, who: str, what: object, outcome: object = "begins") -> None:
        """Add an entry, also to the file."""
        entry = Entry(round(time.monotonic() - self._began, 3), who, str(what), str(outcome))
        self.entries.append(entry)
        if self._file is not None:
            self._file.write(msgspec.json.encode(entry) + b"\n")

    def tail(self, count: int) -> str:
        """Return the last entries as lines."""
        return "\n".join(map(str, self.entries[-count:]))

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
