"""A platform with two Robot endpoints, whose processes can be made to fail and are restarted as by `rce up`."""

from __future__ import annotations

import contextlib
import secrets
from collections.abc import AsyncIterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO

from rce.api.client import ApiClient
from rce.bench.chaos import processes
from rce.bench.chaos.disks import MEGABYTE, Disk, mounted
from rce.client import Robot
from rce.client.map_service import MapServiceClient
from rce.errors import InternalError
from rce.process.supervisor import ManagedProcess
from rce.process.up import default_typesupport

USER, ADMINISTRATOR = "testUser", "admin"  # of platforms started with --dev
TASK_SET, MAPS = "container", "map-service"
ENDPOINTS = ("robot-1", "robot-2")
PROGRAMS = {"master": "master", "robot-1": "robot", "robot-2": "robot", TASK_SET: "container", MAPS: "map-service"}
SIZES = {"master": 48, "robot-1": 4, "robot-2": 4, TASK_SET: 96, MAPS: 16}  # MB
GRACE = 10.0  # seconds, of robots
SLOTS = 20
COMMAND_TIMEOUT = 180.0  # seconds; longer than any fault


class Platform:
    """A running platform.

    Attributes:
        directory: Directory of its data; each process has one of its own name in it.
        processes: Its processes by name.
        disks: Disks by the name of the process; none where file systems cannot be mounted.
        log: File with the logs of all processes.
    """

    def __init__(self, directory: Path, disks: dict[str, Disk], log: Path) -> None:
        """Prepare a platform; `start` starts it."""
        self.directory = directory
        self.disks = disks
        self.log = log
        self._tokens = {name: secrets.token_hex(32) for name in PROGRAMS}
        self._out = log.open("w")
        self.processes = {name: self._process(name, self._out) for name in PROGRAMS}

    @property
    def url(self) -> str:
        """URL of the robots' entry."""
        ready = self.processes["master"].ready
        assert ready is not None
        return ready.url

    def robot(self, name: str) -> Robot:
        """Return a robot of the user."""
        return Robot(self.url, user=USER, robot=name, password=USER, timeout=COMMAND_TIMEOUT)

    def api(self, user: str = USER) -> ApiClient:
        """Return a client of the HTTP API; users of `--dev` have their names as passwords."""
        return ApiClient(self.url, user=user, password=user)

    def maps(self, patience: float = COMMAND_TIMEOUT) -> MapServiceClient:
        """Return a client of the map service as the user."""
        return MapServiceClient(self.url, user=USER, password=USER, patience=patience)

    async def start(self) -> None:
        """Start the Master, then the others, one after the other so that each starts in time on a busy machine.

        Raises:
            StartFailed: A process did not start.
        """
        for process in self.processes.values():
            await process.start()

    async def stop(self) -> None:
        """Stop all processes, the Master last."""
        for name in reversed(PROGRAMS):
            await self.processes[name].stop()
        self._out.close()

    def _process(self, name: str, log: IO[str]) -> ManagedProcess:
        if name == "master":
            roles = {each: PROGRAMS[each] if each != MAPS else "service" for each in PROGRAMS if each != name}
            allowed = ",".join(f"{role}:{each}:{self._tokens[each]}" for each, role in roles.items())
            return ManagedProcess("master", self._master, {"RCE_TOKENS": allowed}, log)
        arguments = {TASK_SET: self._task_set, MAPS: self._maps}.get(name, lambda: self._robot(name))
        return ManagedProcess(PROGRAMS[name], arguments, {"RCE_TOKEN": self._tokens[name]}, log)

    def _port(self, name: str) -> str:
        """Return the port of a process for users; 0 until it has one."""
        ready = self.processes[name].ready
        return ready.url.rstrip("/").rpartition(":")[2] if ready is not None else "0"

    def _master(self) -> list[str]:
        ready = self.processes["master"].ready
        control = ready.control.rpartition(":")[2] if ready is not None else "0"
        return [
            f"--data-dir={self.directory / 'master'}",
            f"--http=tcp:{self._port('master')}:interface=127.0.0.1",
            f"--control=tcp:{control}:interface=127.0.0.1",
            f"--grace={GRACE}",
            "--dev",
        ]

    def _joining(self, name: str) -> list[str]:
        ready = self.processes["master"].ready
        assert ready is not None
        return [f"--data-dir={self.directory / name}", f"--master={ready.control}"]

    def _robot(self, name: str) -> list[str]:
        port = self._port(name)
        return [*self._joining(name), f"--name={name}", "--ws-host=127.0.0.1", f"--ws-port={port}", f"--grace={GRACE}"]

    def _task_set(self) -> list[str]:
        words = [f"--name={TASK_SET}", "--engine=process", "--allow-root", f"--size={SLOTS}", "--stop-environments"]
        return [*self._joining(TASK_SET), *words, f"--typesupport={default_typesupport()}"]

    def _maps(self) -> list[str]:
        return [*self._joining(MAPS), f"--entry={self.url}", f"--port={self._port(MAPS)}", "--spare=0"]


@contextlib.asynccontextmanager
async def running(directory: Path) -> AsyncIterator[Platform]:
    """Run a platform in a directory, with disks of its own if this process may mount them.

    Raises:
        StartFailed: A process did not start.
        InternalError: Something of an environment is left after the end.
    """
    with ExitStack() as stack:
        data = directory / "data"
        disks = stack.enter_context(mounted({data / name: size * MEGABYTE for name, size in SIZES.items()}))
        platform = Platform(data, {path.name: disk for path, disk in disks.items()}, directory / "log")
        try:
            await platform.start()
            yield platform
        except BaseException:
            await platform.stop()
            processes.kill_all(data)
            raise
        await platform.stop()
        left, directories = processes.kill_all(data), list((data / TASK_SET / "environments").glob("*/*"))
        if left or directories:
            raise InternalError(f"{left} processes and {len(directories)} directories are left after the end")
