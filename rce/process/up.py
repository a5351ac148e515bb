"""`rce up`: Master, Robot endpoint, Container task set and services on this machine, as one process tree.

A process that dies is restarted with the same ports and data. When this process ends for whatever reason, the kernel
signals its children, so they end too, and with them the environments.
"""

from __future__ import annotations

import asyncio
import contextlib
import getpass
import os
import secrets
import signal
import sys
from collections.abc import Awaitable, Callable, Iterable
from pathlib import Path
from typing import IO, Annotated, Literal

from msgspec import Meta, Struct

from rce.errors import InvalidRequest
from rce.net.listener import bind
from rce.net.loopback import is_loopback
from rce.process import programs
from rce.process.ready import Ready
from rce.process.supervisor import ManagedProcess
from rce.process.terminal_log import terminal_log

WS_PORT, MAPS_PORT, KNOWLEDGE_PORT = 9010, 9040, 9050
SERVICES = {
    "map-service": (("aiohttp", "lxml", "rosbags"), "server"),
    "knowledge-service": (("aiohttp", "rdflib", "pyoxigraph"), "server,knowledge"),
}
"""By service: the libraries that it needs, and the extras that install them."""


def default_typesupport() -> str:
    """Return the directory of the type support that provisioning has built for this Python, or an empty string."""
    built = Path(sys.prefix) / "typesupport" / "current"
    return str(built.resolve()) if built.exists() else ""


Port = Annotated[int, Meta(ge=0, le=65535)]


class Settings(Struct):
    """Run the whole platform on this machine: one command, one process tree."""

    data_dir: Annotated[Path, Meta(description="directory for all stored data")] = Path("~/.local/share/rce")
    http_port: Annotated[
        int, Meta(ge=0, le=65535, description="port of the robots' HTTP entry and the dashboard; 0 for a free one")
    ] = 9000
    ws_port: Annotated[
        Port | None,
        Meta(description="port of the robots' WebSocket; 0 for a free one (default: 9010, or 0 if http_port is)"),
    ] = None
    maps_port: Annotated[
        Port | None, Meta(description="port of the map service; 0 for a free one (default: 9040, or 0 if http_port is)")
    ] = None
    knowledge_port: Annotated[
        Port | None,
        Meta(description="port of the knowledge service; 0 for a free one (default: 9050, or 0 if http_port is)"),
    ] = None
    host: Annotated[str, Meta(description="address to listen on; with --dev 127.0.0.1")] = "127.0.0.1"
    engine: Annotated[Literal["process", "docker", "swarm"], Meta(description="engine that runs environments")] = (
        "process"
    )
    size: Annotated[int, Meta(ge=1, description="slots for environments")] = 10
    robot_processes: Annotated[int, Meta(ge=1, le=64, description="processes that serve robots, a core each")] = 1
    warm: Annotated[
        int, Meta(ge=0, le=100, description="process engine: endpoints that wait for environments, which start sooner")
    ] = 0
    dev: Annotated[bool, Meta(description="create the users admin/admin and testUser/testUser, loopback only")] = False
    allow_unisolated: Annotated[bool, Meta(description="accept other machines although nodes run as this user")] = False
    allow_root: Annotated[bool, Meta(description="run nodes as root with the process engine")] = False
    grace: Annotated[float, Meta(ge=0, description="grace period in seconds of a robot's session without a socket")] = (
        10
    )
    bad_messages: Annotated[
        int, Meta(ge=0, description="number of bad messages per minute that closes a socket; 0 for no limit")
    ] = 100
    certificate: Annotated[str, Meta(description="PEM file for https and wss")] = ""
    private_key: Annotated[str, Meta(description="PEM file of its key")] = ""
    package_path: Annotated[list[str], Meta(description="directories with ROS 2 packages, comma-separated")] = []
    converters: Annotated[
        str, Meta(description="Python file, or directory of files, with converters of your own; see the guide")
    ] = ""
    original_forwarders: Annotated[
        Literal["cdr", "ros1"],
        Meta(description="what Forwarders of robots without features carry: CDR, or messages as ROS 1 serializes them"),
    ] = "cdr"
    typesupport: Annotated[str, Meta(description="directory with compiled type support of messages and services")] = (
        default_typesupport()
    )
    verbose: Annotated[bool, Meta(description="print the log of all processes, also at a terminal")] = False

    @property
    def listening_host(self) -> str:
        """Address at which users are served."""
        return "127.0.0.1" if self.dev else self.host

    def port(self, given: int | None, usual: int) -> int:
        """Return the port that was given, or the usual one, or 0 if the HTTP entry has a free one."""
        return given if given is not None else usual if self.http_port else 0


def check_isolation(settings: Settings) -> None:
    """Check that the process engine, which does not isolate users, is reached from this machine only, and not as root.

    Raises:
        InvalidRequest: Users from elsewhere could run programs as this user, or any user as root.
    """
    if settings.dev and not is_loopback(settings.host):
        raise InvalidRequest(
            f"--dev creates users whose passwords everybody knows, so it serves this machine only, and {settings.host} "
            "is not a loopback address: leave out --host, or --dev",
            field="host",
        )
    if settings.engine != "process":
        return
    if not settings.allow_root and os.geteuid() == 0:
        raise InvalidRequest(
            "the process engine would run the nodes of all users as root: run this as another user, use --engine "
            "docker, or --allow-root, as in a container of your own",
            field="allow_root",
        )
    if settings.allow_unisolated or is_loopback(settings.host):
        return
    raise InvalidRequest(
        f"the process engine runs users' programs as this user ({_user()}), so it serves this machine only, and "
        f"{settings.host} is not a loopback address: use --engine docker, or --allow-unisolated",
        field="host",
    )


def isolation(engine: str) -> str:
    """Return how an engine isolates environments, as one line."""
    if engine == "process":
        return f"the process engine does not isolate: nodes of all users run as {_user()} on this machine"
    return f"the {engine} engine isolates: each environment is a container without network and privileges"


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # no such user in the password file
        return f"user {os.getuid()}"


def check_ports(settings: Settings) -> None:
    """Check that the ports can be bound, before the Master prints the password of the first administrator, once only.

    Raises:
        Unavailable: A port is in use, or cannot be bound.
    """
    ports = (
        settings.http_port,
        settings.port(settings.ws_port, WS_PORT),
        settings.port(settings.maps_port, MAPS_PORT),
        settings.port(settings.knowledge_port, KNOWLEDGE_PORT),
    )
    for port in ports:
        bind(settings.listening_host, port).close()


def _port(url_or_endpoint: str) -> str:
    return url_or_endpoint.rstrip("/").rpartition(":")[2]


def make_processes(
    settings: Settings, log: IO[str]
) -> tuple[ManagedProcess, ManagedProcess, ManagedProcess, ManagedProcess, ManagedProcess]:
    """Return Master, Robot endpoint, task set, map service and knowledge service; the Master must be started first."""
    data = settings.data_dir.expanduser().resolve()
    host = settings.listening_host
    tokens = {name: secrets.token_hex(32) for name in ("robot", "container", "maps", "knowledge")}
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
            f"--ws-port={_port(robot.ready.url) if robot.ready else settings.port(settings.ws_port, WS_PORT)}",
            f"--processes={settings.robot_processes}",
            f"--grace={settings.grace}",
            f"--bad-messages={settings.bad_messages}",
            f"--certificate={settings.certificate}",
            f"--private-key={settings.private_key}",
            f"--converters={settings.converters}",
            f"--original-forwarders={settings.original_forwarders}",
        ]

    def container_arguments() -> list[str]:
        assert master.ready is not None
        return [
            f"--data-dir={data / 'container'}",
            f"--master={master.ready.control}",
            "--name=machine-1",
            f"--engine={settings.engine}",
            f"--size={settings.size}",
            f"--warm={settings.warm}",
            f"--package-path={','.join(settings.package_path)}",
            f"--typesupport={settings.typesupport}",
            "--allow-unisolated" if settings.allow_unisolated else "--no-allow-unisolated",
            "--allow-root" if settings.allow_root else "--no-allow-root",
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
            f"--port={_port(maps.ready.url) if maps.ready else settings.port(settings.maps_port, MAPS_PORT)}",
            f"--certificate={own}",
            f"--private-key={settings.private_key}",
        ]

    def knowledge_arguments() -> list[str]:
        assert master.ready is not None
        ready, port = knowledge.ready, settings.port(settings.knowledge_port, KNOWLEDGE_PORT)
        return [
            f"--data-dir={data / 'knowledge'}",
            f"--master={master.ready.control}",
            f"--host={host}",
            f"--port={_port(ready.url) if ready else port}",
            f"--certificate={settings.certificate}",
            f"--private-key={settings.private_key}",
        ]

    names = {
        "robot": "robot:robot-1",
        "container": "container:machine-1",
        "maps": "service:map-service",
        "knowledge": "service:knowledge-service",
    }
    allowed = ",".join(f"{name}:{tokens[owner]}" for owner, name in names.items())
    master = ManagedProcess("master", master_arguments, {"RCE_TOKENS": allowed}, log)
    robot = ManagedProcess("robot", robot_arguments, {"RCE_TOKEN": tokens["robot"]}, log)
    container = ManagedProcess("container", container_arguments, {"RCE_TOKEN": tokens["container"]}, log)
    maps = ManagedProcess("map-service", maps_arguments, {"RCE_TOKEN": tokens["maps"]}, log)
    knowledge = ManagedProcess("knowledge-service", knowledge_arguments, {"RCE_TOKEN": tokens["knowledge"]}, log)
    return master, robot, container, maps, knowledge


async def run(settings: Settings, started: Callable[[Ready], Awaitable[None]], log: IO[str] = sys.stderr) -> None:
    """Start all processes, await `started`, then stop them.

    Args:
        settings: Settings of the platform.
        started: Called with the announcement of the Master once all processes are ready.
        log: File for the logs of all processes.

    Raises:
        InvalidRequest: Users from elsewhere could run programs as this user.
        Unavailable: A port is in use.
        StartFailed: A process did not start.
    """
    check_isolation(settings)
    check_ports(settings)
    print(f"rce up: {isolation(settings.engine)}", file=log, flush=True)
    master, robot, container, maps, knowledge = make_processes(settings, log)
    try:
        entry = await master.start()
        processes = [robot, container]
        for service, (libraries, extras) in SERVICES.items():
            if programs.installed(service, *libraries):
                processes += [each for each in (maps, knowledge) if each.name == service]
            else:
                print(
                    f"rce up: starting without the {service.replace('-', ' ')}, since libraries that it needs are not "
                    f"installed: run pip install '.[{extras}]' in a checkout of RCE",
                    file=log,
                    flush=True,
                )
        await _start_all(processes)
        await started(entry)
    finally:
        # Jobs and environments first, while the Master runs and can be informed; the Master last.
        for process in (maps, knowledge, container, robot, master):
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
    """Run `rce up`: print `ready URL` on standard output, then run until SIGINT or SIGTERM.

    At a terminal, the log is kept in a file, and only what concerns the user is printed.
    """
    loop = asyncio.get_running_loop()
    task = asyncio.current_task()
    assert task is not None
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, task.cancel)

    async def started(entry: Ready) -> None:
        if quiet:
            print(welcome(settings, entry.url, path), file=sys.stderr, flush=True)
        print(f"ready {entry.url}", flush=True)
        await asyncio.Event().wait()

    quiet = sys.stderr.isatty() and not settings.verbose
    path = settings.data_dir.expanduser() / "up.log"
    opened = terminal_log(path) if quiet else contextlib.nullcontext(sys.stderr)
    with opened as log, contextlib.suppress(asyncio.CancelledError):
        await run(settings, started, log)


def welcome(settings: Settings, url: str, log: Path) -> str:
    """Return what a user needs to begin, as some lines."""
    user = "testUser" if settings.dev else "admin"
    password = ", password testUser" if settings.dev else ""
    return "\n".join(
        (
            f"dashboard   {url} (user {user}{password})",
            f"console     rce login {url} --user {user}, in another terminal; then rce env list",
            f"robots      Robot({url!r}, user={user!r}, …) in Python"
            if settings.dev
            else "users       rce user add NAME, there; robots use such a user, not the administrator",
            f"data        {settings.data_dir.expanduser()}",
            f"log         {log}; --verbose prints it here",
            "end         Ctrl-C",
        )
    )
