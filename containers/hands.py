"""`python -P -m containers.hands`: what an agent of a swarm may not do itself to an environment on its node.

The agent starts it through Docker, for a moment, in a container that sees all processes and devices of the node. It
does what the engine `docker` does itself: the same limits, set from outside. `RCE_WORK` says what to do; what fails is
said on the last line, as an error of RCE.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import msgspec
from msgspec import Struct

from containers import docker_disks, shaping
from containers.docker_options import HOME, USER, Machine, rates
from rce.errors import RceError, StartFailed
from rce.messages import Rates

CGROUPS = Path("/sys/fs/cgroup")
CLONE_NEWNS = 0x20000
AT_FDCWD = -100
OPEN_TREE, MOVE_MOUNT = 428, 429  # system calls, by the same numbers on every processor
OPEN_TREE_CLONE, MOVE_MOUNT_F_EMPTY_PATH = 1, 4
_libc = ctypes.CDLL(None, use_errno=True)


class Work(Struct, frozen=True):
    """For the environment whose first process on the node is `process`; bytes, and bytes a second; 0: no limit."""

    process: int
    ground: str  # a directory on the device that images are on
    bandwidth: int = 0
    io: Rates = Rates()
    disk: int = 0
    file: str = ""  # the disk's, to be made

    @property
    def any(self) -> bool:
        return bool(self.bandwidth or self.disk or self.io != Rates())


def do(work: Work) -> None:
    """StartFailed, InvalidRequest."""
    if work.bandwidth:
        shaping.check()
        shaping.shape(work.process, shaping.devices(work.process), work.bandwidth)
    disk = None
    if work.disk:
        docker_disks.check(work.disk)
        disk = docker_disks.make(Path(work.file), work.disk, USER)
    machine = Machine(docker_disks.device_below(Path(work.ground)), buffered=_unified())
    try:
        for kind, each in rates(work.io, disk, machine).items():
            for limit in each:
                _hold(work.process, kind, os.stat(limit["Path"]).st_rdev, limit["Rate"])
        if disk is not None:
            _mount(work.process, disk.device, synchronous=bool(work.io.write) and not machine.buffered)
    finally:
        if disk is not None:
            docker_disks.let_go(disk)


def _unified() -> bool:
    return (CGROUPS / "cgroup.controllers").exists()


def _hold(process: int, kind: str, device: int, rate: int) -> None:
    """Bound the bytes a second that a container reads from a device, or writes to it."""
    number = f"{os.major(device)}:{os.minor(device)}"
    lines = [line.split(":", 2) for line in Path(f"/proc/{process}/cgroup").read_text().splitlines()]
    if _unified():
        file = CGROUPS / lines[0][2].lstrip("/") / "io.max"
        file.write_text(f"{number} {'rbps' if kind == 'device_read_bps' else 'wbps'}={rate}")
        return
    path = next(path for _, controllers, path in lines if "blkio" in controllers.split(","))
    way = "read" if kind == "device_read_bps" else "write"
    (CGROUPS / "blkio" / path.lstrip("/") / f"blkio.throttle.{way}_bps_device").write_text(f"{number} {rate}")


def _mount(process: int, device: str, *, synchronous: bool) -> None:
    """Put a disk over the home of a container, in that container's own view of files."""
    options = "noatime,nosuid,nodev" + (",sync" if synchronous else "")
    with tempfile.TemporaryDirectory() as place:
        subprocess.run(["mount", "-t", "ext4", "-o", options, device, place], check=True)
        try:
            tree = _done(_libc.syscall(OPEN_TREE, AT_FDCWD, place.encode(), OPEN_TREE_CLONE), "open_tree")
        finally:
            subprocess.run(["umount", place], check=True)
    child = os.fork()
    if not child:
        os._exit(_move(tree, f"/proc/{process}/ns/mnt"))
    if os.waitpid(child, 0)[1]:
        raise StartFailed(f"its disk cannot be mounted at {HOME}")


def _move(tree: int, namespace: str) -> int:
    """In a process that can be spared, as it does not come back from there."""
    try:
        with open(namespace) as there:
            _done(_libc.setns(there.fileno(), CLONE_NEWNS), "setns")
        _done(_libc.syscall(MOVE_MOUNT, tree, b"", AT_FDCWD, HOME.encode(), MOVE_MOUNT_F_EMPTY_PATH), "move_mount")
    except OSError as error:
        print(error, file=sys.stderr, flush=True)
        return 1
    return 0


def _done(result: int, what: str) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{what}: {os.strerror(number)}")
    return result


def main() -> int:
    try:
        do(msgspec.json.decode(os.environ["RCE_WORK"], type=Work))
    except RceError as error:
        print(msgspec.json.encode(error.info).decode(), flush=True)
        return 1
    except (OSError, subprocess.CalledProcessError) as error:
        print(msgspec.json.encode(StartFailed(str(error)).info).decode(), flush=True)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
