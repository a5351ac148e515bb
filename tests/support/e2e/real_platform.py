"""`rce up` as a process: started, observed, parts of it killed, and checked for leftovers."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from rce.client import Robot

RCE = str(Path(sys.executable).with_name("rce"))
START_TIMEOUT = 120.0
STOP_TIMEOUT = 120.0
USER = "testUser"
_segment = re.compile(r"/dev/shm/fastdds_[0-9a-f]{16}")


async def until(condition: Callable[[], object], seconds: float = 60.0, what: str = "") -> None:
    """Poll a condition that has no event, such as processes and files, until it holds or the time is over."""
    try:
        async with asyncio.timeout(seconds):
            while not condition():  # noqa: ASYNC110
                await asyncio.sleep(0.02)
    except TimeoutError:
        raise AssertionError(f"not within {seconds:g} s: {what or condition}") from None


class RealPlatform:
    """A platform in `directory`, by which all of its processes are found.

    `async with` starts and stops it, also if it starts only in part or if the test fails.

    Attributes:
        url: The robots' entry.
        output: Standard output until the platform was ready.
        segments: Shared memory of Fast DDS that its processes have used.
    """

    def __init__(self, directory: Path, *arguments: str, dev: bool = True, program: str = RCE) -> None:
        """Prepare a platform that the command `program` starts with these arguments of `rce up`."""
        self._mode = ["--dev"] if dev else []
        self.directory = directory
        self.url = ""
        self.output = ""
        self.segments: set[Path] = set()
        self._arguments = arguments
        self._program = program
        self._process: asyncio.subprocess.Process

    async def __aenter__(self) -> Self:
        try:
            await self.start()
        except BaseException:
            await self._clean_up()
            raise
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        await (self.stop() if kind is None else self._clean_up())

    async def _clean_up(self) -> None:
        with suppress(AssertionError):  # the first failure is reported
            await self.stop()
        kill_processes(self.directory)

    @property
    def log(self) -> str:
        return (self.directory / "log").read_text()

    async def start(self) -> None:
        words = [
            self._program,
            "up",
            *self._mode,
            "--http-port",
            "0",
            "--data-dir",
            str(self.directory / "data"),
            *self._arguments,
        ]
        with (self.directory / "log").open("w") as log:
            self._process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE, stderr=log)
        assert self._process.stdout is not None
        line = ""
        while not line.startswith(("ready http://", "ready https://")):
            line = (await asyncio.wait_for(self._process.stdout.readline(), START_TIMEOUT)).decode()
            assert line, f"{self.output}\n{self.log}"
            self.output += line
        self.url = line.split()[1]

    async def stop(self) -> None:
        """Stop the platform by SIGINT, unless it was killed, and check that nothing is left."""
        self.record_segments()
        if self._process.returncode is not None:
            self.check_nothing_left()
            return
        self._process.send_signal(signal.SIGINT)
        try:
            status = await asyncio.wait_for(self._process.wait(), STOP_TIMEOUT)
        except TimeoutError:
            self._process.kill()
            raise AssertionError(f"rce up did not stop\n{self.log[-4000:]}") from None
        assert status == 0, self.log[-4000:]
        self.check_nothing_left()

    def check_nothing_left(self) -> None:
        """Assert that no process, directory or shared memory is left."""
        assert not self.processes(), "processes are left over"
        assert not list((self.directory / "data" / "container" / "environments").glob("*")), "directories are left over"
        end = time.monotonic() + 30
        while left := [path for path in self.segments if path.exists()]:  # another platform may be removing it
            assert time.monotonic() < end, f"segments of shared memory are left over: {left}"
            time.sleep(0.1)

    def processes(self) -> dict[int, str]:
        """Return the command lines of the platform's processes by pid."""
        return processes_of(self.directory)

    def pid(self, pattern: str, but: int = 0) -> int:
        """Return the pid of the one process whose command line matches, or 0 if there is none except `but`.

        A child that has not executed its program yet has the command line of its parent, and does not count.
        """
        matching = {pid for pid, words in self.processes().items() if re.search(pattern, words)}
        found = [pid for pid in matching if pid != but and _parent(pid) not in matching]
        assert len(found) <= 1, found
        return found[0] if found else 0

    def environment_pid(self, tag: str, but: int = 0, user: str = USER) -> int:
        """Return the pid of an Environment endpoint, or 0 if there is none except `but`.

        A child that has not executed its program yet does not count, as in `pid`.
        """
        variable = f"RCE_NAME={user}/{tag}\0".encode()
        endpoints = {pid for pid, words in self.processes().items() if "endpoints.environment" in words}
        for pid in endpoints - {but}:
            with suppress(OSError):
                if variable in Path(f"/proc/{pid}/environ").read_bytes() and _parent(pid) not in endpoints:
                    return pid
        return 0

    def kill(self, pid: int) -> None:
        """Kill a process as the kernel's out-of-memory killer does."""
        assert pid in self.processes()
        self.record_segments()
        os.kill(pid, signal.SIGKILL)

    def record_segments(self) -> None:
        """Remember the shared memory that the processes use now."""
        for pid in self.processes():
            with suppress(OSError):
                self.segments |= {Path(each) for each in _segment.findall(Path(f"/proc/{pid}/maps").read_text())}

    def robot(self, name: str, timeout: float = 60.0) -> Robot:
        """Return a robot of the test user."""
        return Robot(self.url, user=USER, robot=name, password=USER, timeout=timeout)


def processes_of(directory: Path) -> dict[int, str]:
    """Return the command lines of processes that have a directory in command line or environment, by pid."""
    return {
        pid: words
        for pid in map(int, filter(str.isdigit, os.listdir("/proc")))
        if (words := _words(pid, str(directory))) is not None
    }


def kill_processes(directory: Path) -> list[str]:
    """Kill the processes that `processes_of` finds and return their command lines."""
    left = processes_of(directory)
    for pid in left:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return list(left.values())


def _parent(pid: int) -> int:
    """Return the pid of a process's parent, or 0 if the process has ended."""
    with suppress(OSError):
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    return 0


def _words(pid: int, mark: str) -> str | None:
    place = Path(f"/proc/{pid}")
    with suppress(OSError):
        command = (place / "cmdline").read_bytes()
        if not command:
            return None  # a zombie
        if mark.encode() in command + (place / "environ").read_bytes():
            return command.replace(b"\0", b" ").decode()
    return None


def containers(api: Any, platform: RealPlatform, tag: str = "") -> list[dict[str, Any]]:
    """Return the containers of a platform with the engine `docker`, stopped ones included; with a tag only its own."""
    labels = [f"rce.directory={platform.directory / 'data' / 'container'}"]
    labels += [f"rce.environment={USER}/{tag}"] if tag else []
    found: list[dict[str, Any]] = api.containers(all=True, filters={"label": labels})
    return found
