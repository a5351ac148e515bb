"""Parts of the client of tus; `test_map_service.py` and `test_recordings.py` have it at work."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from rce.client.tus import fingerprint, wait_before_retry
from rce.errors import NotFound, TimedOut, Unavailable


def test_fingerprint_tells_files_apart(tmp_path: Path) -> None:
    path = tmp_path / "a"
    marks = set()
    for content, stamp in ((b"abc", 1), (b"abd", 1), (b"abc", 2)):
        path.write_bytes(content)
        os.utime(path, ns=(0, stamp))
        marks.add(fingerprint(path))
    assert len(marks) == 3


@pytest.mark.parametrize(
    ("error", "raised"), [(NotFound("x"), NotFound), (TimeoutError(), TimedOut), (OSError("cut"), Unavailable)]
)
def test_retries_end_at_the_deadline(error: Exception, raised: type[Exception]) -> None:
    wait_before_retry(time.monotonic() + 100, 0.0, error)
    with pytest.raises(raised):
        wait_before_retry(time.monotonic() - 1, 0.0, error)
