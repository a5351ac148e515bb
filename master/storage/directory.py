"""Data directory of a Master, given by people."""

from __future__ import annotations

from pathlib import Path

from rce.errors import NotFound

DATABASE = "master.db"


def master_directory(given: Path) -> Path:
    """Return the Master's data directory: the given one, or `master` in it if it is that of `rce up`."""
    inner = given / "master"
    return inner if (inner / DATABASE).exists() and not (given / DATABASE).exists() else given


def existing_master_directory(given: Path) -> Path:
    """Return the Master's data directory, as `master_directory`.

    Raises:
        NotFound: It does not exist, or has no database of a Master.
    """
    directory = master_directory(given)
    if not directory.is_dir():
        raise NotFound(f"there is no directory {directory}: give the Master's with --data-dir")
    if not (directory / DATABASE).exists():
        raise NotFound(f"{directory} has no database of a Master: give its directory with --data-dir")
    return directory
