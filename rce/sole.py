"""A directory that one process at a time works in."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rce.errors import AlreadyExists


@contextmanager
def sole_user(directory: Path, program: str) -> Iterator[None]:
    """Make `directory` if need be and have it alone, until the block or the process ends. AlreadyExists, OSError.

    `program`: what works there ("Master"), for the file `master.lock` and the error.
    """
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    with (directory / f"{program.lower().replace(' ', '-')}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise AlreadyExists(
                f"another {program} works in {directory}: end it, or give this one a directory of its own (--data-dir)"
            ) from None
        yield
