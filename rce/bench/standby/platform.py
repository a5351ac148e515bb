"""Two Masters and PostgreSQL on machines of a simulated network; two Robot endpoints and two task sets beside them."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import secrets
import socket
import tempfile
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path

from rce.api.client import ApiClient
from rce.api.http import EntryClient
from rce.api.views.accounts import NewUser
from rce.api.views.machines import MachineView
from rce.bench.chaos import processes
from rce.bench.network.bridge import Network
from rce.bench.standby import clock
from rce.bench.standby.database import Database
from rce.bench.standby.programs import Program
from rce.client import Robot
from rce.errors import RceError, TimedOut, Unavailable
from rce.process import programs
from rce.process.up import default_typesupport

MASTERS = ("master-1", "master-2")
ENDPOINTS = ("robot-1", "robot-2")
TASK_SETS = ("container-1", "container-2")
DATABASE = "database"
USER, PASSWORD, ADMINISTRATOR = "testUser", "password of a bench", "admin"
HTTP, CONTROL = 9000, 8080
SLOTS = 10
COMMAND_TIMEOUT = 180.0  # seconds; longer than any fault
START_TIMEOUT = 120.0
_password = re.compile(r"administrator is 'admin' with password '([^']+)'")


class Platform:
    """A running platform.

    Attributes:
        network: The machines.
        database: PostgreSQL.
        programs: The processes by name.
        clocks: Clocks of the Masters and the database, by name.
        directory: Directory of the data of all processes.
    """

    def __init__(self, directory: Path, network: Network, database: Path, log: Path) -> None:
        """Prepare a platform; `start` starts it."""
        self.directory = directory
        self.network = network
        library = clock.build(database)
        self.clocks = {name: clock.Clock(library, database / f"{name}.clock") for name in (*MASTERS, DATABASE)}
        address, prefix = network.addresses[DATABASE], network.command_prefix(DATABASE)
        self.database = Database(database / "postgresql", address, prefix, self.clocks[DATABASE].environment)
        self._out = log.open("w")
        self._tokens = {name: secrets.token_hex(32) for name in (*ENDPOINTS, *TASK_SETS)}
        self._ports = {name: _free_port() for name in ENDPOINTS}
        self.programs = {name: self._program(name) for name in (*MASTERS, *ENDPOINTS, *TASK_SETS)}
        self._administrator = ""

    def url(self, master: str) -> str:
        """Return the URL of a Master's entry."""
        return f"http://{self.network.addresses[master]}:{HTTP}/"

    @property
    def urls(self) -> str:
        """URLs of the entries of both Masters."""
        return ",".join(map(self.url, MASTERS))

    def robot(self, name: str) -> Robot:
        """Return a robot of the user, which knows both Masters."""
        return Robot(self.urls, user=USER, robot=name, password=PASSWORD, timeout=COMMAND_TIMEOUT)

    def api(self, user: str = USER, master: str = "") -> ApiClient:
        """Return a client of the HTTP API of the Master that leads, or of a certain one."""
        password = self._administrator if user == ADMINISTRATOR else PASSWORD
        return ApiClient(self.url(master) if master else self.urls, user=user, password=password)

    async def start(self) -> None:
        """Start everything, and create the user.

        Raises:
            Unavailable: PostgreSQL is not installed.
            TimedOut: A process does not start.
        """
        await asyncio.to_thread(self.database.start)
        for master in MASTERS:
            self.programs[master].start()
        await self._until(lambda: bool(self._administrator), "no Master leads")
        await self._until(self._create_user, "no user was created")
        for name in (*ENDPOINTS, *TASK_SETS):
            self.programs[name].start()
        await self._until(self._is_ready, "not all processes have joined")

    def wait_for_masters(self) -> None:
        """Wait until both Masters answer, the leader and the standby.

        Raises:
            Unavailable: One does not for a long time.
        """
        until = time.monotonic() + START_TIMEOUT
        for master in MASTERS:
            client = EntryClient(self.url(master), {})
            while True:
                try:
                    client.open("GET", "healthz").close()
                    break
                except Unavailable:
                    if time.monotonic() > until:
                        raise
                time.sleep(0.1)

    async def stop(self) -> None:
        """Stop everything, the Masters last."""
        for name in reversed(self.programs):
            await self.programs[name].stop()
        with contextlib.suppress(RceError):
            await asyncio.to_thread(self.database.stop)
        self._out.close()

    def _create_user(self) -> bool:
        self.api(ADMINISTRATOR).entry.json("POST", "api/v1/users", NewUser(USER, PASSWORD))
        return True

    def _is_ready(self) -> bool:
        self.api().entry.open("GET", "readyz").close()
        found = list(self.api(ADMINISTRATOR).items(MachineView, "machines"))
        return len(found) == len(self._tokens) and all(each.state == "joined" for each in found)

    def _take_output(self, line: str) -> None:
        found = _password.search(line)
        self._administrator = found[1] if found else self._administrator

    def _program(self, name: str) -> Program:
        if name in MASTERS:
            roles = {each: "robot" if each in ENDPOINTS else "container" for each in self._tokens}
            allowed = ",".join(f"{role}:{each}:{self._tokens[each]}" for each, role in roles.items())
            environment = {"RCE_TOKENS": allowed} | self.clocks[name].environment
            return Program(name, lambda: self._master(name), environment, self._out, self._take_output)
        command = self._robot if name in ENDPOINTS else self._task_set
        return Program(name, lambda: command(name), {"RCE_TOKEN": self._tokens[name]}, self._out, self._take_output)

    def _master(self, name: str) -> list[str]:
        address = self.network.addresses[name]
        return [
            *self.network.command_prefix(name),
            *programs.command("master"),
            f"--data-dir={self.directory / name}",
            f"--database={self.database.url}",
            f"--http=tcp:{HTTP}:interface={address}",
            f"--control=tcp:{CONTROL}:interface={address}",
        ]

    def _joining(self, name: str) -> list[str]:
        masters = ",".join(f"tcp:{self.network.addresses[each]}:{CONTROL}" for each in MASTERS)
        return [f"--data-dir={self.directory / name}", f"--name={name}", f"--master={masters}"]

    def _robot(self, name: str) -> list[str]:
        port = self._ports[name]
        words = ["--ws-host=127.0.0.1", f"--ws-port={port}", f"--public-url=ws://127.0.0.1:{port}/"]
        return [*programs.command("robot"), *self._joining(name), *words]

    def _task_set(self, name: str) -> list[str]:
        words = ["--engine=process", "--allow-root", "--allow-unisolated", f"--size={SLOTS}", "--stop-environments"]
        command = [*programs.command("container"), *self._joining(name), *words]
        return [*command, f"--typesupport={default_typesupport()}"]

    async def _until(self, true: Callable[[], bool], what: str) -> None:
        reason = ""
        try:
            async with asyncio.timeout(START_TIMEOUT):
                while True:
                    try:
                        if await asyncio.to_thread(true):
                            return
                    except Unavailable as error:
                        reason = str(error)
                    await asyncio.sleep(0.1)
        except TimeoutError:
            raise TimedOut(f"{what} after {START_TIMEOUT:g} s: {reason}") from None


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@contextlib.asynccontextmanager
async def running(directory: Path) -> AsyncIterator[Platform]:
    """Run a platform with its data in a directory. Needs root.

    Raises:
        Unavailable: There are no network namespaces, or no PostgreSQL.
        TimedOut: A process did not start.
    """
    network = Network([*MASTERS, DATABASE])
    with tempfile.TemporaryDirectory(prefix="rce-standby-") as database:
        os.chmod(database, 0o755)  # PostgreSQL runs as another user
        platform = Platform(directory / "data", network, Path(database), directory / "log")
        try:
            network.make()
            await platform.start()
            yield platform
        finally:
            await platform.stop()
            processes.kill_all(directory / "data")
            network.remove()
