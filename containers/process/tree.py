"""Processes of an environment, identified by an environment variable that children inherit and watched by pidfd.

The variable has the run, which is unique on the machine: every process with it is taken for one of the environment.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rce.errors import TimedOut

MARKER = "RCE_RUN"
KILL_TIMEOUT = 10.0
RESCAN = 0.01
EXEC_TIME = 0.0005
EXEC_TRIES = 1000


class Watch:
    """Calls a function once when a process has ended; the process need not be a child of this one."""

    def __init__(self, pid: int, ended: Callable[[], None]) -> None:
        """Watch the process with this pid.

        Raises:
            ProcessLookupError: There is no such process.
        """
        self.ended = asyncio.Event()
        self._callback = ended
        self._fd = os.pidfd_open(pid)
        asyncio.get_running_loop().add_reader(self._fd, self._readable)

    def send(self, number: signal.Signals) -> None:
        """Signal the process, unless it has ended."""
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._fd, number)

    def close(self) -> None:
        """Stop watching."""
        if self._fd >= 0:
            asyncio.get_running_loop().remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    def _readable(self) -> None:
        self.close()
        self.ended.set()
        self._callback()


def environ(pid: int) -> list[bytes]:
    """Return `NAME=value` of the variables that a process was started with; none if it is gone or not accessible."""
    process = Path(f"/proc/{pid}")
    try:
        for _ in range(EXEC_TRIES):
            text = (process / "environ").read_bytes()
            if text or not _has_variables(process):
                break
            time.sleep(EXEC_TIME)
    except (FileNotFoundError, ProcessLookupError, PermissionError):
        return []
    return text.split(b"\0")


def _has_variables(process: Path) -> bool:
    """Return True if a process has variables, or may get some: during execve(2) its new memory lacks them.

    See proc_pid_stat(5). A zombie has no memory. The kernel sets the end of the code after the variables.
    """
    stat = (process / "stat").read_text().rpartition(")")[2].split()
    virtual_size, end_of_code, begin, end = (int(stat[place]) for place in (20, 24, 47, 48))
    return virtual_size > 0 and (end_of_code == 0 or end > begin)


def has_marker(pid: int, run: str) -> bool:
    """Return True if a process runs and inherited the marker of this run."""
    return f"{MARKER}={run}".encode() in environ(pid)


def marked(run: str) -> list[int]:
    """Return all running processes with the marker of this run."""
    return [int(entry) for entry in os.listdir("/proc") if entry.isdigit() and has_marker(int(entry), run)]


async def kill_marked(run: str) -> None:
    """Kill every process with the marker of this run, and those started meanwhile.

    Raises:
        TimedOut: Some still run after KILL_TIMEOUT.
    """
    try:
        async with asyncio.timeout(KILL_TIMEOUT):
            while pids := await asyncio.to_thread(marked, run):
                for pid in pids:
                    _kill(pid, run)
                await asyncio.sleep(RESCAN)
    except TimeoutError:
        raise TimedOut(f"processes of run {run} still run {KILL_TIMEOUT:g} s after they were killed") from None


def _kill(pid: int, run: str) -> None:
    try:
        fd = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        if has_marker(pid, run):  # checked again while the fd holds the pid, which may have been reused
            signal.pidfd_send_signal(fd, signal.SIGKILL)
    except ProcessLookupError:
        pass
    finally:
        os.close(fd)


def describe_end(status: int | None) -> str:
    """Describe an exit status; negative is the number of the signal that ended the process, None is unknown."""
    if status is None:
        return "ended; its exit status is not known, because an earlier task set started it"
    if status < 0:
        return f"was killed by signal {-status} ({signal.strsignal(-status)})"
    return f"ended with status {status}"
