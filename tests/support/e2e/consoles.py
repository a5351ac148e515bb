"""The command `rce` in a process of its own, as a user runs it: with and without a terminal."""

from __future__ import annotations

import asyncio
import fcntl
import os
import pty
import re
import select
import signal
import struct
import subprocess
import termios
import time
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path

from tests.support import programs
from tests.support.e2e.real_platform import RCE, USER

TIMEOUT = 120.0
MAX_MATCH = 1000  # bytes
_control = re.compile(rb"\x1b\[[0-9;?]*[A-Za-z]|\x1b[=>]")


def user_environ(home: Path, url: str = "", user: str = USER) -> dict[str, str]:
    """Return the environment variables of a user with this home directory, with credentials if there is a URL."""
    environ = {key: value for key, value in os.environ.items() if not key.startswith("RCE_")}
    environ |= {"XDG_CONFIG_HOME": str(home / "config"), "XDG_STATE_HOME": str(home / "state")}
    environ |= {"TERM": "xterm", "HOME": str(home), "PROMPT_TOOLKIT_NO_CPR": "1"}
    return environ | ({"RCE_URL": url, "RCE_USER": user, "RCE_PASSWORD": user} if url else {})


async def rce(*words: str, env: Mapping[str, str], given: str = "", status: int | None = 0) -> str:
    """Run a command and return its standard output, or for another status than 0 all that it printed.

    Args:
        words: The command line.
        env: Environment variables.
        given: Standard input.
        status: The expected exit status; None for any.
    """
    pipe = subprocess.PIPE
    async with programs.running(RCE, *words, env=env, stdin=pipe, stdout=pipe, stderr=pipe) as process:
        out, err = await asyncio.wait_for(process.communicate(given.encode()), TIMEOUT)
    report = f"rce {' '.join(words)}: {process.returncode}\n{out.decode()}\n{err.decode()}"
    assert status is None or process.returncode == status, report
    return out.decode() if status == 0 else report


async def no_guest_interfaces(env: Mapping[str, str]) -> None:
    """Wait until the interfaces of guests are removed, which happens shortly after their programs end."""
    async with asyncio.timeout(TIMEOUT):
        while "@" in await rce("interface", "list", env=env):
            pass


class RunningCommand:
    """A command that prints until it is interrupted, read line by line from a pipe."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def expect_line(self, pattern: str) -> str:
        """Return the next line that has a match."""
        assert self._process.stdout is not None
        async with asyncio.timeout(TIMEOUT):
            while line := (await self._process.stdout.readline()).decode():
                if re.search(pattern, line):
                    return line
        raise AssertionError(f"the command ended without {pattern!r}")

    async def interrupt(self) -> int:
        """Send SIGINT and return the exit status."""
        self._process.send_signal(signal.SIGINT)
        return await asyncio.wait_for(self._process.wait(), TIMEOUT)


@asynccontextmanager
async def running(*words: str, env: Mapping[str, str]) -> AsyncIterator[RunningCommand]:
    """Run a command of `rce` in the background."""
    async with programs.running(RCE, *words, env=env, stdout=subprocess.PIPE) as process:
        yield RunningCommand(process)


class TerminalProcess:
    """A program with a pseudo-terminal as its controlling terminal; the methods block and belong in a thread."""

    def __init__(self, words: list[str], env: Mapping[str, str], rows: int = 24, columns: int = 80) -> None:
        self.master, slave = pty.openpty()
        self.resize(rows, columns)
        self.process = subprocess.Popen(
            ["setsid", "--ctty", *words], env=dict(env), stdin=slave, stdout=slave, stderr=slave
        )
        os.close(slave)
        self.output = b""

    def resize(self, rows: int, columns: int) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def type(self, text: str) -> None:
        os.write(self.master, text.encode())

    def read(self, seconds: float = 0.5) -> bool:
        """Read what the program has printed, waiting for it as long; return False at the end of the output."""
        if not select.select([self.master], [], [], seconds)[0]:
            return True
        try:
            data = os.read(self.master, 65536)
        except OSError:
            return False
        self.output += _control.sub(b"", data)
        return bool(data)

    def expect(self, pattern: str, seconds: float = TIMEOUT) -> str:
        """Wait for a match of at most MAX_MATCH bytes; return and discard the output up to its end."""
        end = time.monotonic() + seconds
        wanted = re.compile(pattern.encode())
        start = 0
        while (match := wanted.search(self.output, start)) is None:
            assert time.monotonic() < end, f"no {pattern!r} in {self.output[-3000:]!r}"
            start = max(0, len(self.output) - MAX_MATCH)
            more = self.read()
            assert more or wanted.search(self.output, start), f"ended without {pattern!r}: {self.output[-3000:]!r}"
        text = self.output[: match.end()].decode()
        self.output = self.output[match.end() :]
        return text

    def wait(self, seconds: float = TIMEOUT) -> int:
        """Read until the program ends and return its exit status."""
        end = time.monotonic() + seconds
        while self.read(0.1) and self.process.poll() is None:
            assert time.monotonic() < end, f"does not end: {self.output[-3000:]!r}"
        return self.process.wait(max(0.1, end - time.monotonic()))

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self.master)


@contextmanager
def on_terminal(*words: str, env: Mapping[str, str]) -> Iterator[TerminalProcess]:
    """Run a command of `rce` on a pseudo-terminal."""
    process = TerminalProcess([RCE, *words], env)
    try:
        yield process
    finally:
        process.close()
