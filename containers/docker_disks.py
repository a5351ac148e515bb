"""Disks of a fixed size for environments: a file with a file system in it, behind a loop device that Docker mounts.

Docker mounts it into the container and unmounts it when that ends. The device is marked to go with its last mount, so
nothing needs to be remembered: what a killed task set left is found by the directory that the files are in.
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
    """`device` is the loop device of its file; `size` is in bytes."""

    device: str
    size: int


def check(size: int) -> None:
    """InvalidRequest if no disk of this size can be made here."""
    if os.geteuid() != 0:
        raise InvalidRequest(
            "this machine's task set is not root, and so cannot make disks of a fixed size: leave disk out",
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
    """InvalidRequest for less than a file system needs."""
    if size < SMALLEST:
        raise InvalidRequest(f"disk {size} is less than the smallest, {SMALLEST}", field="containerData.disk")


def make(file: Path, size: int, owner: int) -> Disk:
    """A new disk, empty and `owner`'s, its space taken at once. Blocks; OSError, StartFailed."""
    with file.open("xb") as opened:
        os.posix_fallocate(opened.fileno(), 0, size)
    # What is in it goes with the environment: no journal.
    options = ["-q", "-F", "-m", "0", "-O", "^has_journal", "-E", f"root_owner={owner}:{owner},nodiscard"]
    _run("mkfs.ext4", *options, str(file))
    return Disk(_run("losetup", "--find", "--show", str(file)).strip(), size)


def let_go(disk: Disk) -> None:
    """The device goes with its last mount, at once if there is none."""
    _run("losetup", "--detach", disk.device)


def sweep(root: Path) -> None:
    """The same for all disks whose files are below `root`."""
    for backing in BLOCK.glob("loop*/loop/backing_file"):
        try:
            file = backing.read_text().strip().removesuffix(" (deleted)")
        except OSError:
            continue  # it goes just now
        if Path(file).is_relative_to(root):
            _run("losetup", "--detach", f"/dev/{backing.parents[1].name}")


def device_below(path: Path) -> str:
    """The whole disk that a directory is on, as a device; empty where none is known for it."""
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
