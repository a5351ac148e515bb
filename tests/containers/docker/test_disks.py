"""Disks of a fixed size: files with a file system, on loop devices."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from containers.docker import disks
from containers.docker.disks import SMALLEST, Disk, check, detach, make, sweep, underlying_disk
from rce.errors import InvalidRequest, StartFailed

MB = 1024 * 1024
needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="loop devices need root: run the tests as root")


def attached(root: Path) -> set[str]:
    """Return the names of files below a directory that are behind loop devices."""
    files = (disks._file_behind(path) for path in disks.BLOCK.glob("loop*/loop/backing_file"))
    return {file.name for file in files if file is not None and file.is_relative_to(root)}


@pytest.fixture
def directory(tmp_path: Path) -> Iterator[Path]:
    yield tmp_path
    sweep(tmp_path)


@needs_root
def test_disk_is_an_empty_file_system_of_its_owner(directory: Path) -> None:
    disk = make(directory / "a.disk", 8 * MB, 10000)
    file, mount = directory / "a.disk", directory / "mount"
    assert disk.size == 8 * MB
    assert file.stat().st_blocks * 512 >= 8 * MB, "its space is allocated"
    mount.mkdir()
    subprocess.run(["mount", disk.device, mount], check=True)
    try:
        detach(disk)
        assert attached(directory) == {"a.disk"}, "a mounted device stays"
        assert (mount.stat().st_uid, mount.stat().st_gid) == (10000, 10000)
        seen = os.statvfs(mount)
        assert 6 * MB < seen.f_bavail * seen.f_frsize <= 8 * MB
    finally:
        subprocess.run(["umount", mount], check=True)
    deadline = time.monotonic() + 60
    while attached(directory):  # a container that starts at this moment has a copy of the mount for an instant
        assert time.monotonic() < deadline, "the device goes with its last mount"
        time.sleep(0.01)


@needs_root
def test_disks_of_one_directory_are_detached(directory: Path) -> None:
    for name in ("one", "other"):
        (directory / name).mkdir()
        make(directory / name / f"{name}.disk", 2 * MB, 0)
    (directory / "one" / "one.disk").unlink()  # the device keeps a deleted file
    sweep(directory / "one")
    assert attached(directory) == {"other.disk"}


@needs_root
def test_file_that_exists_is_not_overwritten(directory: Path) -> None:
    (directory / "a.disk").write_bytes(b"content")
    with pytest.raises(FileExistsError):
        make(directory / "a.disk", 2 * MB, 0)
    assert (directory / "a.disk").read_bytes() == b"content"


def test_disk_larger_than_the_free_space_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"No space left|too large"):
        make(tmp_path / "a.disk", 2**50, 0)


def test_failed_program_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disks, "_program", lambda name: "/bin/false")
    with pytest.raises(StartFailed, match=r"^mkfs.ext4: status 1$"):
        make(tmp_path / "a.disk", 2 * MB, 0)


class Losetup:
    """`losetup --detach` that fails; before that the device gets another file, or none."""

    def __init__(self, backing: Path, file: str | None) -> None:
        self._backing = backing
        self._file = file

    def __call__(self, name: str, *words: str) -> str:
        if self._file is None:
            self._backing.unlink()
        else:
            self._backing.write_text(self._file)
        raise StartFailed("losetup: /dev/loop7: detach failed: No such device or address")


@pytest.mark.parametrize("now", [None, "/elsewhere/b.disk\n"])
def test_disk_that_is_detached_meanwhile_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, now: str | None
) -> None:
    backing = fake_device(tmp_path, monkeypatch)
    monkeypatch.setattr(disks, "_run", Losetup(backing, now))
    sweep(tmp_path / "environments")


def test_disk_that_cannot_be_detached_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    backing = fake_device(tmp_path, monkeypatch)
    monkeypatch.setattr(disks, "_run", Losetup(backing, backing.read_text()))
    with pytest.raises(StartFailed, match="loop7"):
        sweep(tmp_path / "environments")


def fake_device(directory: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the file that names the file of the device `loop7`, which is in the directory `environments`."""
    backing = directory / "block" / "loop7" / "loop" / "backing_file"
    backing.parent.mkdir(parents=True)
    backing.write_text(f"{directory}/environments/a.disk\n")
    monkeypatch.setattr(disks, "BLOCK", directory / "block")
    return backing


def test_disk_too_small_for_a_file_system_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(disks, "_program", lambda name: f"/sbin/{name}")
    check(SMALLEST)
    with pytest.raises(InvalidRequest, match="less than the smallest") as raised:
        check(SMALLEST - 1)
    assert raised.value.field == "containerData.disk"


def test_disk_is_refused_without_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(InvalidRequest, match="does not run as root"):
        check(MB)


def test_missing_programs_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(disks, "_program", lambda name: None)
    with pytest.raises(InvalidRequest, match=r"no mkfs.ext4, losetup to make a disk with: apt-get install"):
        check(MB)


def test_directory_in_memory_is_on_no_disk() -> None:
    assert underlying_disk(Path("/proc")) == ""
    assert Disk("/dev/loop7", MB).size == MB
