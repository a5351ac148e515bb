"""Processes of an environment: known by a marker that children inherit, watched by pidfd, whoever their parent is."""

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
    """Calls `ended` once, when the process with this pid has ended; the process need not be our child.

    Raises ProcessLookupError when there is none.
    """

    def __init__(self, pid: int, ended: Callable[[], None]) -> None:
        self.ended = asyncio.Event()
        self._callback = ended
        self._fd = os.pidfd_open(pid)
        asyncio.get_running_loop().add_reader(self._fd, self._readable)

    def send(self, number: signal.Signals) -> None:
        """Signal the process, unless it has ended."""
        with suppress(ProcessLookupError):
            signal.pidfd_send_signal(self._fd, number)

    def close(self) -> None:
        if self._fd >= 0:
            asyncio.get_running_loop().remove_reader(self._fd)
            os.close(self._fd)
            self._fd = -1

    def _readable(self) -> None:
        self.close()
        self.ended.set()
        self._callback()


def environ(pid: int) -> list[bytes]:
    """`NAME=value` of what the process was started with; nothing for one that is gone or that we may not look into."""
    process = Path(f"/proc/{pid}")
    try:
        for _ in range(EXEC_TRIES):
            text = (process / "environ").read_bytes()
            if text or not _in_exec(process):
                break
            time.sleep(EXEC_TIME)
    except (FileNotFoundError, ProcessLookupError, PermissionError):
        return []
    return text.split(b"\0")


def _in_exec(process: Path) -> bool:
    """Whether it is amid execve(2): it has memory already, but the environment is not yet in it (proc_pid_stat(5))."""
    stat = (process / "stat").read_text().rpartition(")")[2].split()
    virtual_size, end_of_environment = int(stat[20]), int(stat[48])
    return virtual_size > 0 and end_of_environment == 0


def has_marker(pid: int, run: str) -> bool:
    """Whether the process lives and inherited this run's marker."""
    return f"{MARKER}={run}".encode() in environ(pid)


def marked(run: str) -> list[int]:
    """All living processes with this run's marker."""
    return [int(entry) for entry in os.listdir("/proc") if entry.isdigit() and has_marker(int(entry), run)]


async def kill_marked(run: str) -> None:
    """Kill every process with this run's marker, and what these start meanwhile; TimedOut when some resist."""
    try:
        async with asyncio.timeout(KILL_TIMEOUT):
            while pids := await asyncio.to_thread(marked, run):
                for pid in pids:
                    _kill(pid, run)
                await asyncio.sleep(RESCAN)
    except TimeoutError:
        raise TimedOut(f"processes of run {run} still live {KILL_TIMEOUT:g} s after they were killed") from None


def _kill(pid: int, run: str) -> None:
    try:
        fd = os.pidfd_open(pid)
    except ProcessLookupError:
        return
    try:
        if has_marker(pid, run):  # looked up again now that the fd holds the pid: it may have been another's by then
            signal.pidfd_send_signal(fd, signal.SIGKILL)
    except ProcessLookupError:
        pass
    finally:
        os.close(fd)


def describe_end(status: int | None) -> str:
    """An exit status in words; negative is the signal that ended the process, None is unknown."""
    if status is None:
        return "ended; its exit status is not known because an earlier task set had started it"
    if status < 0:
        return f"was ended by signal {-status} ({signal.strsignal(-status)})"
    return f"ended with status {status}"
