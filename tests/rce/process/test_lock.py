"""Exclusive use of a directory."""

from pathlib import Path

import pytest

from rce.errors import AlreadyExists
from rce.process.lock import lock_directory


def test_lock_is_exclusive_until_released(tmp_path: Path) -> None:
    directory = tmp_path / "a" / "b"
    with (
        lock_directory(directory, "Master"),
        pytest.raises(AlreadyExists, match=r"another Master uses .*/a/b: stop it"),
        lock_directory(directory, "Master"),
    ):
        pass
    with lock_directory(directory, "Master"), lock_directory(directory, "task set"):
        pass
