"""`rce up` as a process of its own, and the means to look at it, hurt it, and see that nothing of it is left."""

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
START_TIMEOUT = 40.0
STOP_TIMEOUT = 40.0
USER = "testUser"
_segment = re.compile(r"/dev/shm/fastdds_[0-9a-f]{16}")


async def until(condition: Callable[[], object], seconds: float = 20.0, what: str = "") -> None:
    """Look again and again, for what has no event (processes, files)."""
    try:
        async with asyncio.timeout(seconds):
            while not condition():  # noqa: ASYNC110
                await asyncio.sleep(0.02)
    except TimeoutError:
        raise AssertionError(f"not within {seconds:g} s: {what or condition}") from None


class RealPlatform:
    """A platform in `directory`, by which all of its processes are found again. `segments` are those of Fast DDS.

    `async with` starts it and stops it, also if it comes up in part only or something fails while it is prepared.
    """

    def __init__(self, directory: Path, *arguments: str, dev: bool = True) -> None:
        self._mode = ["--dev"] if dev else []
        self.directory = directory
        self.url = ""
        self.said = ""  # on standard output
        self.segments: set[Path] = set()
        self._arguments = arguments
        self._process: asyncio.subprocess.Process

    async def __aenter__(self) -> Self:
        try:
            await self.start()
        except BaseException:
            await self._abandon()
            raise
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        await (self.stop() if kind is None else self._abandon())

    async def _abandon(self) -> None:
        with suppress(AssertionError):  # whatever is wrong with it, something went wrong before
            await self.stop()
        kill_processes(self.directory)

    @property
    def log(self) -> str:
        return (self.directory / "log").read_text()

    async def start(self) -> None:
        words = [
            RCE,
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
        while not line.startswith("ready http://"):
            line = (await asyncio.wait_for(self._process.stdout.readline(), START_TIMEOUT)).decode()
            assert line, f"{self.said}\n{self.log}"
            self.said += line
        self.url = line.split()[1]

    async def stop(self) -> None:
        """SIGINT unless it was killed, and then nothing may be left."""
        self.look()
        if self._process.returncode is not None:
            self.check_nothing_left()
            return
        self._process.send_signal(signal.SIGINT)
        try:
            status = await asyncio.wait_for(self._process.wait(), STOP_TIMEOUT)
        except TimeoutError:
            self._process.kill()
            raise AssertionError(f"rce up does not stop\n{self.log[-4000:]}") from None
        assert status == 0, self.log[-4000:]
        self.check_nothing_left()

    def check_nothing_left(self) -> None:
        assert not self.processes(), "processes are left"
        assert not list((self.directory / "data" / "container" / "environments").glob("*")), "directories are left"
        end = time.monotonic() + 5
        while left := [path for path in self.segments if path.exists()]:  # another platform may be about to remove it
            assert time.monotonic() < end, f"segments of shared memory are left: {left}"
            time.sleep(0.1)

    def processes(self) -> dict[int, str]:
        """The command lines of all processes whose command line or environment names our directory, by pid."""
        return processes_of(self.directory)

    def pid(self, pattern: str, but: int = 0) -> int:
        """The one process whose command line this matches; 0 if there is none other than `but`."""
        found = [pid for pid, words in self.processes().items() if re.search(pattern, words) and pid != but]
        assert len(found) <= 1, found
        return found[0] if found else 0

    def environment_pid(self, tag: str, but: int = 0) -> int:
        """The Environment endpoint's process."""
        wanted = f"RCE_NAME={USER}/{tag}\0".encode()
        for pid, words in self.processes().items():
            if pid != but and "endpoints.environment" in words:
                with suppress(OSError):
                    if wanted in Path(f"/proc/{pid}/environ").read_bytes():
                        return pid
        return 0

    def kill(self, pid: int) -> None:
        """SIGKILL, as the kernel's out-of-memory killer would."""
        assert pid in self.processes()
        self.look()
        os.kill(pid, signal.SIGKILL)

    def look(self) -> None:
        """Note the segments of shared memory that our processes have now."""
        for pid in self.processes():
            with suppress(OSError):
                self.segments |= {Path(each) for each in _segment.findall(Path(f"/proc/{pid}/maps").read_text())}

    def robot(self, name: str, timeout: float = 30.0) -> Robot:
        return Robot(self.url, user=USER, robot=name, password=USER, timeout=timeout)


def processes_of(directory: Path) -> dict[int, str]:
    """The command lines of all processes whose command line or environment names this directory, by pid."""
    return {
        pid: words
        for pid in map(int, filter(str.isdigit, os.listdir("/proc")))
        if (words := _words(pid, str(directory))) is not None
    }


def kill_processes(directory: Path) -> list[str]:
    """Those that `processes_of` finds; returns their command lines."""
    left = processes_of(directory)
    for pid in left:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return list(left.values())


def _words(pid: int, mark: str) -> str | None:
    place = Path(f"/proc/{pid}")
    with suppress(OSError):
        command = (place / "cmdline").read_bytes()
        if not command:
            return None  # a zombie
        if mark.encode() in command + (place / "environ").read_bytes():
            return command.replace(b"\0", b" ").decode()
    return None


def containers(api: Any, platform: RealPlatform) -> list[dict[str, Any]]:
    """Docker's, of a platform with the engine `docker`, alive or dead."""
    label = f"rce.directory={platform.directory / 'data' / 'container'}"
    found: list[dict[str, Any]] = api.containers(all=True, filters={"label": label})
    return found
