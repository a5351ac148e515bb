"""Limits that are applied to an environment from outside, when its container already runs.

They are the same limits as the engine `docker` sets with the container. The caller needs root's privileges and must see
all processes and devices of the node.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from msgspec import Struct

from containers.docker import disks, shaping
from containers.docker.block_io import Machine, block_io_limits
from containers.endpoint import HOME
from rce.errors import StartFailed
from rce.protocol.messages import Rates

CGROUPS = Path("/sys/fs/cgroup")
CLONE_NEWNS = 0x20000
AT_FDCWD = -100
OPEN_TREE, MOVE_MOUNT = 428, 429  # numbers of system calls, the same on all architectures
OPEN_TREE_CLONE, MOVE_MOUNT_F_EMPTY_PATH = 1, 4
_libc = ctypes.CDLL(None, use_errno=True)


class LimitRequest(Struct, frozen=True):
    """Limits for the environment whose first process on the node is `process`; 0 is no limit.

    `bandwidth` and `io` are in bytes per second, `disk` is in bytes.
    """

    process: int
    image_directory: str  # any directory on the device that images are stored on
    bandwidth: int = 0
    io: Rates = Rates()
    disk: int = 0
    disk_file: str = ""  # path of the disk's file, which is created
    owner: int = 0  # user id that the disk belongs to

    @property
    def is_empty(self) -> bool:
        """True if there is no limit to apply."""
        return not self.bandwidth and not self.disk and self.io == Rates()


def apply(request: LimitRequest) -> None:
    """Apply limits.

    Raises:
        InvalidRequest: This node cannot apply a limit.
        StartFailed: A program failed.
        OSError: A file or device cannot be written, or the environment has ended.
    """
    if request.bandwidth:
        shaping.check()
        shaping.shape(request.process, shaping.devices(request.process), request.bandwidth)
    disk = None
    if request.disk:
        disks.check(request.disk)
        disk = disks.make(Path(request.disk_file), request.disk, request.owner)
    image_device = disks.underlying_disk(Path(request.image_directory))
    machine = Machine(image_device, limits_buffered_writes=_has_cgroup_v2())
    try:
        for kind, each in block_io_limits(request.io, disk, machine).items():
            for limit in each:
                _limit_rate(request.process, kind, os.stat(limit["Path"]).st_rdev, limit["Rate"])
        if disk is not None:
            synchronous = bool(request.io.write) and not machine.limits_buffered_writes
            _mount_home(request.process, disk.device, synchronous=synchronous)
    finally:
        if disk is not None:
            disks.detach(disk)


def _has_cgroup_v2() -> bool:
    return (CGROUPS / "cgroup.controllers").exists()


def _limit_rate(process: int, kind: str, device: int, rate: int) -> None:
    """Limit the bytes per second that a container reads from a device or writes to it."""
    number = f"{os.major(device)}:{os.minor(device)}"
    lines = [line.split(":", 2) for line in Path(f"/proc/{process}/cgroup").read_text().splitlines()]
    if _has_cgroup_v2():
        file = CGROUPS / lines[0][2].lstrip("/") / "io.max"
        file.write_text(f"{number} {'rbps' if kind == 'device_read_bps' else 'wbps'}={rate}")
        return
    path = next(path for _, controllers, path in lines if "blkio" in controllers.split(","))
    direction = "read" if kind == "device_read_bps" else "write"
    (CGROUPS / "blkio" / path.lstrip("/") / f"blkio.throttle.{direction}_bps_device").write_text(f"{number} {rate}")


def _mount_home(process: int, device: str, *, synchronous: bool) -> None:
    """Mount a disk over the home directory of a container, in the container's mount namespace."""
    options = "noatime,nosuid,nodev" + (",sync" if synchronous else "")
    with tempfile.TemporaryDirectory() as mount_point:
        subprocess.run(["mount", "-t", "ext4", "-o", options, device, mount_point], check=True)
        try:
            tree = _checked(_libc.syscall(OPEN_TREE, AT_FDCWD, mount_point.encode(), OPEN_TREE_CLONE), "open_tree")
        finally:
            subprocess.run(["umount", mount_point], check=True)
    child = os.fork()
    if not child:
        os._exit(_move_mount(tree, f"/proc/{process}/ns/mnt"))
    if os.waitpid(child, 0)[1]:
        raise StartFailed(f"its disk cannot be mounted at {HOME}")


def _move_mount(tree: int, namespace: str) -> int:
    """Attach a mount tree in another mount namespace; return an exit status.

    Runs in a child process, because a process cannot return from another mount namespace.
    """
    try:
        with open(namespace) as target:
            _checked(_libc.setns(target.fileno(), CLONE_NEWNS), "setns")
        _checked(_libc.syscall(MOVE_MOUNT, tree, b"", AT_FDCWD, HOME.encode(), MOVE_MOUNT_F_EMPTY_PATH), "move_mount")
    except OSError as error:
        print(error, file=sys.stderr, flush=True)
        return 1
    return 0


def _checked(result: int, call: str) -> int:
    """Return the result of a system call; raise OSError if it failed."""
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{call}: {os.strerror(number)}")
    return result
