"""The processes of a container, seen from its node: the first one, its control groups, limits and file systems.

The agent sees all processes of its node. All functions block for a moment.
"""

from __future__ import annotations

import ctypes
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from containers.endpoint import HOME, HOME_SIZE, INODES, OPEN_FILES, TEMPORARY_SIZE
from rce.control.calls.watching import EnvironmentUsage
from rce.errors import StartFailed

PROC = Path("/proc")
CGROUPS = Path("/sys/fs/cgroup")
SEARCH_SECONDS = 10.0  # until the first process of a container that runs is there
CLONE_NEWNS = 0x20000
MS_NOSUID, MS_NODEV, MS_REMOUNT = 2, 4, 32
_libc = ctypes.CDLL(None, use_errno=True)


def first_process(container: str) -> int:
    """Return the first process of a container, given its id.

    Raises:
        StartFailed: It has none, because it has ended.
    """
    until = time.monotonic() + SEARCH_SECONDS
    while True:
        for process in _processes():
            if container in _read(process / "cgroup") and _is_first(process):
                return int(process.name)
        if time.monotonic() > until:
            raise StartFailed("its container has no process")
        time.sleep(0.05)


def is_alive(process: int, container: str) -> bool:
    """Return True if a process is still one of a container."""
    return container in _read(PROC / str(process) / "cgroup")


def limit(process: int, pids: int, owner: int, memory: int) -> None:
    """Set the limits that a pod's specification cannot express, before the process starts others.

    Args:
        process: First process of the container.
        pids: Number of processes and threads.
        owner: User who owns the home directory.
        memory: Size of /dev/shm in bytes.

    Raises:
        OSError: A limit cannot be set, or the environment has ended.
    """
    _in_child(lambda: _limit_files(process, owner), "the number of its open files cannot be limited")
    (_group(process, "pids") / "pids.max").write_text(str(pids))
    home = PROC / str(process) / "root" / HOME.lstrip("/")
    os.chown(home, owner, owner)
    home.chmod(0o700)
    # Kubelet makes no use of the sizes before Kubernetes 1.22, and never limits the number of files.
    for path, size in ((HOME, HOME_SIZE), ("/tmp", TEMPORARY_SIZE), ("/dev/shm", memory)):
        options = f"size={size},nr_inodes={INODES}".encode()
        _in_child(partial(_remount, process, path.encode(), options), f"the size of {path} cannot be set")


def used(process: int) -> EnvironmentUsage | None:
    """Return what a container has used; None if it has ended. Memory excludes inactive page cache."""
    try:
        memory, processor = _group(process, "memory"), _group(process, "cpuacct")
        if _unified():
            total, stat = int((memory / "memory.current").read_text()), _fields(memory / "memory.stat")
            seconds = _fields(processor / "cpu.stat")["usage_usec"] / 1e6
        else:
            total, stat = int((memory / "memory.usage_in_bytes").read_text()), _fields(memory / "memory.stat")
            seconds = int((processor / "cpuacct.usage").read_text()) / 1e9
    except (OSError, StopIteration, ValueError):
        return None
    return EnvironmentUsage(seconds, max(0, total - stat.get("total_inactive_file", stat.get("inactive_file", 0))))


def _processes() -> Iterator[Path]:
    return (path for path in PROC.iterdir() if path.name.isdigit())


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:  # the process has ended
        return ""


def _is_first(process: Path) -> bool:
    """Return True if a process has number 1 in its own PID namespace."""
    line = next((line for line in _read(process / "status").splitlines() if line.startswith("NSpid:")), "")
    return len(line.split()) > 2 and line.split()[-1] == "1"


def _unified() -> bool:
    return (CGROUPS / "cgroup.controllers").exists()


def _group(process: int, controller: str) -> Path:
    """Return the control group of a process as the node sees it."""
    lines = [line.split(":", 2) for line in (PROC / str(process) / "cgroup").read_text().splitlines()]
    if _unified():
        return CGROUPS / lines[0][2].lstrip("/")
    path = next(path for _, controllers, path in lines if controller in controllers.split(","))
    return CGROUPS / controller / path.lstrip("/")


def _fields(path: Path) -> dict[str, int]:
    return {key: int(value) for key, value in (line.split() for line in path.read_text().splitlines())}


def _in_child(work: Callable[[], None], failure: str) -> None:
    """Run `work` in a child process: it changes what a process cannot change back.

    Raises:
        OSError: `work` has raised one.
    """
    child = os.fork()
    if not child:
        try:
            work()
        except BaseException as error:  # noqa: BLE001  # nothing may leave the child
            print(f"{failure}: {error!r}", file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        raise OSError(failure)


def _limit_files(process: int, owner: int) -> None:
    """Limit open files and core dumps, as the user of the process: else it takes more than root's privileges."""
    os.setgroups([])
    os.setgid(owner)
    os.setuid(owner)
    resource.prlimit(process, resource.RLIMIT_NOFILE, (OPEN_FILES, OPEN_FILES))
    resource.prlimit(process, resource.RLIMIT_CORE, (0, 0))


def _remount(process: int, path: bytes, options: bytes) -> None:
    """Set the options of a file system in the mount namespace of a process."""
    with open(f"/proc/{process}/ns/mnt") as namespace:
        _checked(_libc.setns(namespace.fileno(), CLONE_NEWNS))
    _checked(_libc.mount(None, path, None, MS_REMOUNT | MS_NOSUID | MS_NODEV, options))


def _checked(result: int) -> None:
    if result < 0:
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
