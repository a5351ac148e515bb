"""Disks that are filled; a small file system in memory needs root."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from rce.bench.chaos.disks import MEGABYTE, mounted
from tests.support.privileges import skip_without_mounts


async def test_full_disk_has_no_room_until_it_is_freed(tmp_path: Path) -> None:
    skip_without_mounts()
    with mounted({tmp_path / "a": MEGABYTE}) as made:
        disk = made[tmp_path / "a"]
        file = tmp_path / "a" / "file"
        disk.fill()
        with pytest.raises(OSError, match="No space left") as full:
            file.write_bytes(bytes(10_000))
        assert full.value.errno == errno.ENOSPC
        await disk.free()
        file.write_bytes(bytes(10_000))
    assert not (tmp_path / "a").is_mount()


def test_without_permission_there_is_no_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with mounted({tmp_path / "a": MEGABYTE}) as made:
        assert made == {}
        assert (tmp_path / "a").is_dir()
