"""Pieces of recordings."""

from __future__ import annotations

import gzip
from pathlib import Path

from tests.support.paths import DATA

LOG = DATA / "mit-csail.clf.gz"


def piece(path: Path, scans: int) -> Path:
    """Write the first scans of MIT CSAIL to a file."""
    with gzip.open(LOG) as log:
        path.write_bytes(b"".join(line for line in log if line.startswith(b"FLASER"))[: scans * 2000])
    lines = path.read_bytes().splitlines(keepends=True)[:-1]
    path.write_bytes(b"".join(lines[:scans]))
    return path
