"""The command `rce` as a user runs it: in a process of its own, with and without a terminal."""

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

from real_platform import RCE, USER

PATIENCE = 60.0
OVERLAP = 1000
_control = re.compile(rb"\x1b\[[0-9;?]*[A-Za-z]|\x1b[=>]")


def surroundings(directory: Path, url: str = "", user: str = USER) -> dict[str, str]:
    """The variables of a user at home in `directory`, who asks at `url`."""
    given = {key: value for key, value in os.environ.items() if not key.startswith("RCE_")}
    given |= {"XDG_CONFIG_HOME": str(directory / "config"), "XDG_STATE_HOME": str(directory / "state")}
    given |= {"TERM": "xterm", "HOME": str(directory), "PROMPT_TOOLKIT_NO_CPR": "1"}
    return given | ({"RCE_URL": url, "RCE_USER": user, "RCE_PASSWORD": user} if url else {})


async def rce(*words: str, env: Mapping[str, str], given: str = "", status: int | None = 0, seconds: float = 0) -> str:
    """Run a command and return its standard output; the status must be this. After `seconds` it gets a Ctrl-C."""
    process = await asyncio.create_subprocess_exec(
        RCE, *words, env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    interrupt = asyncio.get_running_loop().call_later(seconds, process.send_signal, signal.SIGINT) if seconds else None
    try:
        out, err = await asyncio.wait_for(process.communicate(given.encode()), PATIENCE)
    finally:
        if interrupt is not None:
            interrupt.cancel()
        if process.returncode is None:
            process.kill()
            await process.wait()
    told = f"rce {' '.join(words)}: {process.returncode}\n{out.decode()}\n{err.decode()}"
    assert status is None or process.returncode == status, told
    return out.decode() if status == 0 else told


class Following:
    """A command whose output goes on, read line by line by way of a pipe."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def until(self, pattern: str) -> str:
        """The next line that has this."""
        assert self._process.stdout is not None
        async with asyncio.timeout(PATIENCE):
            while line := (await self._process.stdout.readline()).decode():
                if re.search(pattern, line):
                    return line
        raise AssertionError(f"it ended without {pattern!r}")

    async def interrupt(self) -> int:
        """Its status after a Ctrl-C."""
        self._process.send_signal(signal.SIGINT)
        return await asyncio.wait_for(self._process.wait(), PATIENCE)


@asynccontextmanager
async def following(*words: str, env: Mapping[str, str]) -> AsyncIterator[Following]:
    """A command of `rce`."""
    process = await asyncio.create_subprocess_exec(RCE, *words, env=env, stdout=subprocess.PIPE)
    try:
        yield Following(process)
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


class OnTerminal:
    """A program on a pseudo-terminal, which is its controlling one; blocking, for a thread."""

    def __init__(self, words: list[str], env: Mapping[str, str], rows: int = 24, columns: int = 80) -> None:
        self.master, slave = pty.openpty()
        self.resize(rows, columns)
        self.process = subprocess.Popen(
            ["setsid", "--ctty", *words], env=dict(env), stdin=slave, stdout=slave, stderr=slave
        )
        os.close(slave)
        self.seen = b""

    def resize(self, rows: int, columns: int) -> None:
        fcntl.ioctl(self.master, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def type(self, text: str) -> None:
        os.write(self.master, text.encode())

    def read(self, seconds: float = 0.5) -> bool:
        """What there is; False at the end."""
        if not select.select([self.master], [], [], seconds)[0]:
            return True
        try:
            data = os.read(self.master, 65536)
        except OSError:
            return False
        self.seen += _control.sub(b"", data)
        return bool(data)

    def until(self, pattern: str, seconds: float = PATIENCE) -> str:
        """Read until this is there; returns all up to its end, and forgets that. No match is longer than OVERLAP."""
        end = time.monotonic() + seconds
        wanted = re.compile(pattern.encode())
        start = 0
        while (match := wanted.search(self.seen, start)) is None:
            assert time.monotonic() < end, f"no {pattern!r} in {self.seen[-3000:]!r}"
            start = max(0, len(self.seen) - OVERLAP)
            assert self.read() or wanted.search(self.seen, start), f"ended without {pattern!r}: {self.seen[-3000:]!r}"
        text = self.seen[: match.end()].decode()
        self.seen = self.seen[match.end() :]
        return text

    def wait(self, seconds: float = PATIENCE) -> int:
        """Its exit status; what it still writes is read."""
        end = time.monotonic() + seconds
        while self.read(0.1) and self.process.poll() is None:
            assert time.monotonic() < end, f"does not end: {self.seen[-3000:]!r}"
        return self.process.wait(max(0.1, end - time.monotonic()))

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self.master)


@contextmanager
def on_terminal(*words: str, env: Mapping[str, str]) -> Iterator[OnTerminal]:
    """A command of `rce`."""
    made = OnTerminal([RCE, *words], env)
    try:
        yield made
    finally:
        made.close()
