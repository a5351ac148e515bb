"""A program on a pseudo-terminal, in a session of its own."""

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

from rce.terminal import Request

PATIENCE = 1.0  # seconds from the hang-up to SIGKILL
LOOK = 0.02
# Run in the new session: its leader opens the terminal, which becomes that of the session, and becomes the program.
# (A fork of this process itself would be one with threads of ROS.)
INSIDE = """
import os, sys
terminal = os.open(sys.argv[1], os.O_RDWR)
for number in (0, 1, 2):
    os.dup2(terminal, number)
os.closerange(3, 256)
os.execvp(sys.argv[2], sys.argv[2:])
"""


class Process:
    """The program; `master` is our end of its terminal, in non-blocking mode. `status` is None while it runs."""

    def __init__(self, wanted: Request) -> None:
        self.master, slave = pty.openpty()
        os.set_blocking(self.master, False)
        self.resize(wanted.rows, wanted.columns)
        shell = shutil.which("bash") or "/bin/sh"
        program = [shell, "-c", wanted.command] if wanted.command else [shell]
        self._child = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", INSIDE, os.ttyname(slave), *program],
            stdin=subprocess.DEVNULL,
            env={**os.environ, "TERM": wanted.term, "SHELL": shell},
            start_new_session=True,
        )
        self._slave = slave  # kept open: where nobody has it open, reading and writing fail
        self.ended = 0.0

    @property
    def status(self) -> int | None:
        """The exit status, when all that was written before has been read; 128 and the signal that ended it."""
        code = self._child.poll()
        if code is None or self._readable():
            return None
        self.ended = self.ended or time.monotonic()
        return code if code >= 0 else 128 - code

    def read(self, count: int) -> bytes:
        """What has been written on the terminal; the kernel gives some kB of it at a time."""
        found = bytearray()
        with suppress(BlockingIOError):
            while len(found) < count:
                found += os.read(self.master, count - len(found))
        return bytes(found)

    def write(self, data: bytes) -> int:
        try:
            return os.write(self.master, data)
        except BlockingIOError:
            return 0

    def resize(self, rows: int, columns: int) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def end(self) -> None:
        """Hang up, and see to it that nothing of the session is left."""
        os.close(self._slave)
        os.close(self.master)  # the kernel sends SIGHUP to the session's foreground
        until = time.monotonic() + PATIENCE
        while self._session() and time.monotonic() < until:
            self._child.poll()
            time.sleep(LOOK)
        for pid in self._session():
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        self._child.wait()

    def _readable(self) -> bool:
        return bool(select.select([self.master], [], [], 0)[0])

    def _session(self) -> list[int]:
        """The processes of the session that are no zombies."""
        found = []
        for path in Path("/proc").glob("[0-9]*/stat"):
            with suppress(OSError):
                state, _, _, session = path.read_text().rpartition(")")[2].split()[:4]
                if int(session) == self._child.pid and state not in "ZX":
                    found.append(int(path.parent.name))
        return found
