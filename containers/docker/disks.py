"""Disks of a fixed size for environments: files with a file system, on loop devices that Docker mounts.

Docker mounts the device into the container and unmounts it when the container ends. The device is marked to be detached
with its last unmount (autoclear), so no record is needed: the devices that a killed task set left are found by the
directory of their files.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from msgspec import Struct

from rce.errors import InvalidRequest, StartFailed

SMALLEST = 1024 * 1024  # bytes; less cannot hold a file system
BLOCK = Path("/sys/block")
PROGRAMS = ("mkfs.ext4", "losetup")
SYSTEM_PATH = "/usr/sbin:/sbin"


class Disk(Struct, frozen=True):
    """A disk; `device` is the loop device of its file, `size` is in bytes."""

    device: str
    size: int


def check(size: int) -> None:
    """Check that a disk of this size can be made here.

    Raises:
        InvalidRequest: The size is too small, or this machine cannot make disks.
    """
    if os.geteuid() != 0:
        raise InvalidRequest(
            "this machine's task set does not run as root, so it cannot make disks of a fixed size: leave disk out",
            field="containerData.disk",
        )
    lacking = [name for name in PROGRAMS if _program(name) is None]
    if lacking:
        raise InvalidRequest(
            f"this machine has no {', '.join(lacking)} to make a disk with: apt-get install e2fsprogs mount",
            field="containerData.disk",
        )
    check_size(size)


def check_size(size: int) -> None:
    """Check the size of a disk in bytes.

    Raises:
        InvalidRequest: It is smaller than a file system needs.
    """
    if size < SMALLEST:
        raise InvalidRequest(f"disk {size} is less than the smallest, {SMALLEST}", field="containerData.disk")


def make(file: Path, size: int, owner: int) -> Disk:
    """Make an empty disk that belongs to the user `owner`, with all of its space allocated. Blocks.

    Raises:
        OSError: The file cannot be written, for example because there is no space left.
        StartFailed: A program failed.
    """
    with file.open("xb") as opened:
        os.posix_fallocate(opened.fileno(), 0, size)
    # No journal: the contents do not outlive the environment.
    options = ["-q", "-F", "-m", "0", "-O", "^has_journal", "-E", f"root_owner={owner}:{owner},nodiscard"]
    _run("mkfs.ext4", *options, str(file))
    return Disk(_run("losetup", "--find", "--show", str(file)).strip(), size)


def detach(disk: Disk) -> None:
    """Mark the device to be detached with its last unmount, or at once if it is not mounted."""
    _run("losetup", "--detach", disk.device)


def sweep(root: Path) -> None:
    """Detach all disks whose files are below `root`.

    Raises:
        StartFailed: A disk cannot be detached.
    """
    for backing in BLOCK.glob("loop*/loop/backing_file"):
        file = _file_behind(backing)
        if file is None or not file.is_relative_to(root):
            continue
        try:
            _run("losetup", "--detach", f"/dev/{backing.parents[1].name}")
        except StartFailed:
            if _file_behind(backing) == file:
                raise


def _file_behind(backing: Path) -> Path | None:
    """Return the file of a loop device; None if it was detached meanwhile."""
    try:
        return Path(backing.read_text().strip().removesuffix(" (deleted)"))
    except OSError:
        return None


def underlying_disk(path: Path) -> str:
    """Return the device of the whole disk that a directory is on; empty if there is none, as for overlay or tmpfs."""
    number = path.stat().st_dev
    entry = Path(f"/sys/dev/block/{os.major(number)}:{os.minor(number)}")
    if not entry.exists():
        return ""
    entry = entry.resolve()
    return f"/dev/{(entry.parent if (entry / 'partition').exists() else entry).name}"


def _program(name: str) -> str | None:
    return shutil.which(name, path=f"{os.environ.get('PATH', os.defpath)}:{SYSTEM_PATH}")


def _run(name: str, *arguments: str) -> str:
    done = subprocess.run([_program(name) or name, *arguments], capture_output=True, text=True)
    if done.returncode:
        raise StartFailed(f"{name}: {done.stderr.strip() or f'status {done.returncode}'}")
    return done.stdout
