"""`rce up`: Master, Robot endpoint, Container task set and map service on this machine, as one process tree.

A process that dies is restarted with the same ports and data. When this process ends for whatever reason, the kernel
signals its children, so they end too, and with them the environments.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import signal
import sys
from collections.abc import Awaitable, Callable, Iterable
from pathlib import Path
from typing import IO, Annotated, Literal

from msgspec import Meta, Struct

from rce.process import programs
from rce.process.ready import Ready
from rce.process.supervisor import ManagedProcess


def default_typesupport() -> str:
    """Return the directory of the type support that provisioning has built for this Python, or an empty string."""
    built = Path(sys.prefix) / "typesupport" / "current"
    return str(built.resolve()) if built.exists() else ""


class Settings(Struct):
    """Run the whole platform on this machine: one command, one process tree."""

    data_dir: Annotated[Path, Meta(description="directory for all stored data")] = Path("~/.local/share/rce")
    http_port: Annotated[
        int, Meta(ge=0, le=65535, description="port of the robots' HTTP entry; with 0 all ports are free ones")
    ] = 9000
    ws_port: Annotated[int, Meta(ge=0, le=65535, description="port of the robots' WebSocket; 0 for a free one")] = 9010
    maps_port: Annotated[int, Meta(ge=0, le=65535, description="port of the map service; 0 for a free one")] = 9020
    host: Annotated[str, Meta(description="address to listen on; with --dev always the loopback address")] = "127.0.0.1"
    engine: Annotated[Literal["process", "docker", "swarm"], Meta(description="engine that runs environments")] = (
        "process"
    )
    size: Annotated[int, Meta(ge=1, description="slots for environments")] = 10
    dev: Annotated[bool, Meta(description="create the users admin/admin and testUser/testUser, loopback only")] = False
    allow_unisolated: Annotated[bool, Meta(description="accept other machines although nodes run as this user")] = False
    grace: Annotated[float, Meta(ge=0, description="grace period in seconds of a robot's session without a socket")] = (
        10
    )
    bad_messages: Annotated[
        int, Meta(ge=0, description="number of bad messages per minute that closes a socket; 0 for no limit")
    ] = 100
    certificate: Annotated[str, Meta(description="PEM file for https and wss")] = ""
    private_key: Annotated[str, Meta(description="PEM file of its key")] = ""
    package_path: Annotated[list[str], Meta(description="directories with ROS 2 packages, comma-separated")] = []
    typesupport: Annotated[str, Meta(description="directory with compiled type support of messages and services")] = (
        default_typesupport()
    )


def _port(url_or_endpoint: str) -> str:
    return url_or_endpoint.rstrip("/").rpartition(":")[2]


def make_processes(
    settings: Settings, log: IO[str]
) -> tuple[ManagedProcess, ManagedProcess, ManagedProcess, ManagedProcess]:
    """Return Master, Robot endpoint, task set and map service; the Master must be started before the others."""
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
    master = ManagedProcess("master", master_arguments, {"RCE_TOKENS": allowed}, log)
    robot = ManagedProcess("robot", robot_arguments, {"RCE_TOKEN": tokens["robot"]}, log)
    container = ManagedProcess("container", container_arguments, {"RCE_TOKEN": tokens["container"]}, log)
    maps = ManagedProcess("map-service", maps_arguments, {"RCE_TOKEN": tokens["service"]}, log)
    return master, robot, container, maps


async def run(settings: Settings, started: Callable[[Ready], Awaitable[None]], log: IO[str] = sys.stderr) -> None:
    """Start all processes, await `started`, then stop them.

    Args:
        settings: Settings of the platform.
        started: Called with the announcement of the Master once all processes are ready.
        log: File for the logs of all processes.

    Raises:
        StartFailed: A process did not start.
    """
    if settings.http_port == 0:
        settings.ws_port = settings.maps_port = 0
    master, robot, container, maps = make_processes(settings, log)
    try:
        entry = await master.start()
        processes = [robot, container]
        if programs.installed("map-service", "aiohttp", "lxml", "rosbags"):
            processes.append(maps)
        else:
            print(
                "rce up: starting without the map service, since libraries that it needs are not installed: "
                "run pip install '.[server]' in a checkout of RCE",
                file=log,
                flush=True,
            )
        await _start_all(processes)
        await started(entry)
    finally:
        # Jobs and environments first, while the Master runs and can be informed; the Master last.
        for process in (maps, container, robot, master):
            await process.stop()


async def _start_all(processes: Iterable[ManagedProcess]) -> None:
    """Start processes concurrently; if one fails, cancel the starts of the others."""
    starts = [asyncio.create_task(process.start()) for process in processes]
    try:
        await asyncio.gather(*starts)
    finally:
        for start in starts:
            start.cancel()
        await asyncio.wait(starts)


async def serve(settings: Settings) -> None:
    """Run `rce up`: print `ready URL` on standard output, then run until SIGINT or SIGTERM."""
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
