"""Trees of directories as hostile programs make them."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def nest(directory: Path, depth: int) -> None:
    """Make directories in each other, deeper than Python recurses and longer than any path."""
    directory.mkdir()
    handle = os.open(directory, os.O_RDONLY)
    for _ in range(depth):
        os.mkdir("deeper", dir_fd=handle)
        inner = os.open("deeper", os.O_RDONLY, dir_fd=handle)
        os.close(handle)
        handle = inner
    os.close(handle)


def names(directory: Path) -> list[str]:
    """Return the sorted names of what a directory has."""
    return sorted(os.listdir(directory))


@contextmanager
def cleared(directory: Path) -> Iterator[None]:
    """Remove a directory after the block; pytest cannot remove trees deeper than Python recurses."""
    try:
        yield
    finally:
        subprocess.run(["rm", "-rf", "--", str(directory)], check=True)
