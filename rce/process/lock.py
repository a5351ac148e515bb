"""Exclusive use of a data directory by one process."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rce.errors import AlreadyExists


@contextmanager
def lock_directory(directory: Path, program: str) -> Iterator[None]:
    """Create `directory` if it is missing, and lock it until the block or the process ends.

    Args:
        directory: The directory.
        program: Name of the program ("Master"), for the lock file (`master.lock`) and the error.

    Raises:
        AlreadyExists: Another process has the lock.
        OSError: The directory cannot be created or written.
    """
    directory.mkdir(parents=True, exist_ok=True, mode=0o700)
    with (directory / f"{program.lower().replace(' ', '-')}.lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise AlreadyExists(
                f"another {program} uses {directory}: stop it, or choose another directory for this one (--data-dir)"
            ) from None
        yield
