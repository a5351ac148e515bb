"""`rce up`: Master, Robot endpoint, Container task set and map service on this machine, as one process tree.

A part that dies is started again, at the same ports and with what it has stored. When this process ends, however that
comes, its parts end too (the kernel signals them), and with them the environments.
"""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import os
import secrets
import signal
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import IO, Annotated, Literal

from msgspec import Meta, Struct

from rce import programs
from rce.errors import StartFailed
from rce.ready import Ready, parse

START_TIMEOUT = 30.0
STOP_TIMEOUT = 30.0
PAUSE_FIRST, PAUSE_MOST = 0.1, 5.0
STEADY = 10.0  # a part that ran this long had started well
PR_SET_PDEATHSIG = 1


def default_typesupport() -> str:
    """What provisioning has built beside this Python, if anything."""
    built = Path(sys.prefix) / "typesupport" / "current"
    return str(built.resolve()) if built.exists() else ""


class Settings(Struct):
    """Run the whole platform on this machine: one command, one process tree."""

    data_dir: Annotated[Path, Meta(description="directory for all that is kept")] = Path("~/.local/share/rce")
    http_port: Annotated[int, Meta(ge=0, le=65535, description="port of the robots' entry; 0 takes free ports")] = 9000
    ws_port: Annotated[int, Meta(ge=0, le=65535, description="port of the robots' WebSocket; 0 takes a free one")] = (
        9010
    )
    maps_port: Annotated[int, Meta(ge=0, le=65535, description="port of the map service; 0 takes a free one")] = 9020
    host: Annotated[str, Meta(description="address to listen on; with --dev always the loopback address")] = "127.0.0.1"
    engine: Annotated[Literal["process", "docker", "swarm"], Meta(description="what runs environments")] = "process"
    size: Annotated[int, Meta(ge=1, description="slots for environments")] = 10
    dev: Annotated[bool, Meta(description="create the users admin/admin and testUser/testUser, loopback only")] = False
    allow_unisolated: Annotated[bool, Meta(description="serve other machines although nodes run as this user")] = False
    grace: Annotated[float, Meta(ge=0, description="seconds for which a robot without a socket keeps its session")] = 10
    bad_messages: Annotated[int, Meta(ge=0, description="bad messages a minute that close a socket; 0: never")] = 100
    certificate: Annotated[str, Meta(description="PEM file for https and wss")] = ""
    private_key: Annotated[str, Meta(description="PEM file of its key")] = ""
    package_path: Annotated[list[str], Meta(description="directories with ROS 2 packages, comma-separated")] = []
    typesupport: Annotated[str, Meta(description="directory with built type support of messages and services")] = (
        default_typesupport()
    )


class Part:
    """One program: kept running until stopped."""

    def __init__(self, name: str, arguments: Callable[[], list[str]], secret: dict[str, str], log: IO[str]) -> None:
        self.name = name
        self.ready: Ready | None = None
        self._arguments = arguments
        self._environment = os.environ | secret
        self._log = log
        self._process: asyncio.subprocess.Process | None = None
        self._keeper: asyncio.Task[None] | None = None
        self._announced = asyncio.Event()

    async def start(self) -> Ready:
        """StartFailed if it ends or says nothing; its reason stands in its log."""
        await self._launch()
        self._keeper = asyncio.create_task(self._keep())
        announced = asyncio.create_task(self._announced.wait())
        await asyncio.wait({announced, self._keeper}, timeout=START_TIMEOUT, return_when=asyncio.FIRST_COMPLETED)
        announced.cancel()
        if self.ready is None:
            raise StartFailed(f"rce {self.name} did not start: what it said above tells why")
        return self.ready

    @property
    def pid(self) -> int:
        """Of its present life; only once it has started."""
        assert self._process is not None
        return self._process.pid

    async def _launch(self) -> None:
        words = programs.command(self.name) + self._arguments()
        self._process = await asyncio.create_subprocess_exec(
            *words,
            stdout=asyncio.subprocess.PIPE,
            stderr=self._log,
            env=self._environment,
            preexec_fn=_end_with_parent,
            start_new_session=True,  # a Ctrl-C is for this process, which stops the parts in their order
        )

    async def _keep(self) -> None:
        pause = PAUSE_FIRST
        loop = asyncio.get_running_loop()
        while True:
            assert self._process is not None
            began = loop.time()
            await self._listen(self._process)
            status = await self._process.wait()
            if self.ready is None:
                return
            print(f"rce up: {self.name} ended with status {status}; starting it again", file=self._log, flush=True)
            pause = PAUSE_FIRST if loop.time() - began > STEADY else min(2 * pause, PAUSE_MOST)
            await asyncio.sleep(pause)
            await self._launch()

    async def _listen(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            ready = parse(line)
            if ready is None:
                sys.stdout.buffer.write(line)
                sys.stdout.flush()
            elif self.ready is None:  # later lives have the ports of the first
                self.ready = ready
                self._announced.set()

    async def stop(self) -> None:
        if self._keeper is not None:
            self._keeper.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._keeper
        process = self._process
        if process is None or process.returncode is not None:
            return
        process.terminate()
        try:
            await asyncio.wait_for(process.wait(), STOP_TIMEOUT)
        except TimeoutError:
            process.kill()
            await process.wait()


def _end_with_parent() -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _port(url_or_endpoint: str) -> str:
    return url_or_endpoint.rstrip("/").rpartition(":")[2]


def make_parts(settings: Settings, log: IO[str]) -> tuple[Part, Part, Part, Part]:
    """Master, Robot endpoint, task set and map service; the later ones take the control address from the first."""
    data = settings.data_dir.expanduser().resolve()
    host = "127.0.0.1" if settings.dev else settings.host
    tokens = {name: secrets.token_hex(32) for name in ("robot", "container", "service")}
    certificate = (
        f":privateKey={settings.private_key or settings.certificate}:certKey={settings.certificate}"
        if settings.certificate
        else ""
    )

    def master_arguments() -> list[str]:
        http = _port(master.ready.url) if master.ready else str(settings.http_port)
        control = _port(master.ready.control) if master.ready else "0"
        kind = "ssl" if certificate else "tcp"
        return [
            f"--data-dir={data / 'master'}",
            f"--http={kind}:{http}:interface={host}{certificate}",
            f"--control=tcp:{control}:interface=127.0.0.1",
            f"--grace={settings.grace}",
            "--dev" if settings.dev else "--no-dev",
        ]

    def robot_arguments() -> list[str]:
        assert master.ready is not None
        return [
            f"--data-dir={data / 'robot'}",
            f"--master={master.ready.control}",
            f"--ws-host={host}",
            f"--ws-port={_port(robot.ready.url) if robot.ready else settings.ws_port}",
            f"--grace={settings.grace}",
            f"--bad-messages={settings.bad_messages}",
            f"--certificate={settings.certificate}",
            f"--private-key={settings.private_key}",
        ]

    def container_arguments() -> list[str]:
        assert master.ready is not None
        return [
            f"--data-dir={data / 'container'}",
            f"--master={master.ready.control}",
            "--name=machine-1",
            f"--engine={settings.engine}",
            f"--size={settings.size}",
            f"--package-path={','.join(settings.package_path)}",
            f"--typesupport={settings.typesupport}",
            "--allow-unisolated" if settings.allow_unisolated else "--no-allow-unisolated",
            "--stop-environments",
        ]

    def maps_arguments() -> list[str]:
        assert master.ready is not None
        own = settings.certificate
        return [
            f"--data-dir={data / 'maps'}",
            f"--master={master.ready.control}",
            f"--entry={master.ready.url.replace('//0.0.0.0:', '//127.0.0.1:')}",
            f"--trust={own}",
            f"--host={host}",
            f"--port={_port(maps.ready.url) if maps.ready else settings.maps_port}",
            f"--certificate={own}",
            f"--private-key={settings.private_key}",
        ]

    names = {"robot": "robot-1", "container": "machine-1", "service": "map-service"}
    allowed = ",".join(f"{role}:{name}:{tokens[role]}" for role, name in names.items())
    master = Part("master", master_arguments, {"RCE_TOKENS": allowed}, log)
    robot = Part("robot", robot_arguments, {"RCE_TOKEN": tokens["robot"]}, log)
    container = Part("container", container_arguments, {"RCE_TOKEN": tokens["container"]}, log)
    maps = Part("map-service", maps_arguments, {"RCE_TOKEN": tokens["service"]}, log)
    return master, robot, container, maps


async def run(settings: Settings, started: Callable[[Ready], Awaitable[None]], log: IO[str] = sys.stderr) -> None:
    """Start everything, await `started` with the entry's address, then stop everything. Logs go to `log`."""
    if settings.http_port == 0:
        settings.ws_port = settings.maps_port = 0
    master, robot, container, maps = make_parts(settings, log)
    try:
        entry = await master.start()
        parts = [robot, container]
        if programs.installed("map-service", "aiohttp", "lxml", "rosbags"):
            parts.append(maps)
        else:
            print(
                "rce up: no map service, since it is not installed whole: pip install '.[server]' in a checkout of RCE",
                file=log,
                flush=True,
            )
        await asyncio.gather(*(part.start() for part in parts))
        await started(entry)
    finally:
        # Jobs and environments first, while there is a Master to tell; then who needs the Master, then the Master.
        for part in (maps, container, robot, master):
            await part.stop()


async def serve(settings: Settings) -> None:
    """`rce up`: say `ready …` on standard output, then run until SIGINT or SIGTERM."""
    loop = asyncio.get_running_loop()
    task = asyncio.current_task()
    assert task is not None
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, task.cancel)

    async def started(entry: Ready) -> None:
        print(f"ready {entry.url}", flush=True)
        await asyncio.Event().wait()

    with contextlib.suppress(asyncio.CancelledError):
        await run(settings, started)
