"""Program on a pseudo-terminal, in its own session."""

from __future__ import annotations

import fcntl
import os
import pty
import select
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from contextlib import suppress
from pathlib import Path

from rce.protocol.terminal import Request

KILL_AFTER = 1.0  # seconds from the hang-up to SIGKILL
POLL_INTERVAL = 0.02  # seconds between checks whether the session has ended
# Runs in the new session: the session leader opens the terminal, which thereby becomes the controlling terminal, and
# executes the program. A separate interpreter does this, since a fork of this process would have threads of ROS. Python
# ignores SIGPIPE and SIGXFSZ, which the program would inherit.
BOOTSTRAP = """
import os, signal, sys
for number in (signal.SIGPIPE, signal.SIGXFSZ):
    signal.signal(number, signal.SIG_DFL)
terminal = os.open(sys.argv[1], os.O_RDWR)
for number in (0, 1, 2):
    os.dup2(terminal, number)
os.closerange(3, 256)
os.execvp(sys.argv[2], sys.argv[2:])
"""


class Process:
    """Program on a pseudo-terminal.

    Attributes:
        master: Descriptor of our end of the terminal, non-blocking.
        ended: Monotonic time when the exit status was first read; 0 before.
    """

    def __init__(self, request: Request) -> None:
        """Start the program of a request, by default a shell."""
        self.master, slave = pty.openpty()
        os.set_blocking(self.master, False)
        self.resize(request.rows, request.columns)
        shell = shutil.which("bash") or "/bin/sh"
        program = [shell, "-c", request.command] if request.command else [shell]
        self._child = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", BOOTSTRAP, os.ttyname(slave), *program],
            stdin=subprocess.DEVNULL,
            env={**os.environ, "TERM": request.term, "SHELL": shell},
            start_new_session=True,
        )
        self._slave = slave  # kept open: reading and writing fail when no process has it open
        self.ended = 0.0

    @property
    def status(self) -> int | None:
        """Exit status, or 128 and the number of the signal that ended the program.

        It is None while the program runs, and until its output has been read.
        """
        code = self._child.poll()
        if code is None or self._readable():
            return None
        self.ended = self.ended or time.monotonic()
        return code if code >= 0 else 128 - code

    def read(self, count: int) -> bytes:
        """Return up to `count` bytes of output. The kernel returns a few kB a call, so this reads repeatedly."""
        found = bytearray()
        with suppress(BlockingIOError):
            while len(found) < count:
                found += os.read(self.master, count - len(found))
        return bytes(found)

    def write(self, data: bytes) -> int:
        """Write input; return the number of bytes that the terminal has accepted."""
        try:
            return os.write(self.master, data)
        except BlockingIOError:
            return 0

    def resize(self, rows: int, columns: int) -> None:
        """Set the size of the terminal."""
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def end(self) -> None:
        """Hang up the terminal, and kill what is left of the session after a grace period."""
        os.close(self._slave)
        os.close(self.master)  # the kernel sends SIGHUP to the foreground of the session
        deadline = time.monotonic() + KILL_AFTER
        while self._session_pids() and time.monotonic() < deadline:
            self._child.poll()
            time.sleep(POLL_INTERVAL)
        for pid in self._session_pids():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._child.wait()

    def _readable(self) -> bool:
        return bool(select.select([self.master], [], [], 0)[0])

    def _session_pids(self) -> list[int]:
        """Return the processes of the session that are not zombies."""
        found = []
        for path in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):
                state, _, _, session = path.read_text().rpartition(")")[2].split()[:4]
                if int(session) == self._child.pid and state not in "ZX":
                    found.append(int(path.parent.name))
        return found
