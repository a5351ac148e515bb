"""A platform of several machines: Master, and a Robot endpoint and a Container task set on each of the others.

The machines are network namespaces (namespaces.py), or this machine under several names.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from rce.api.client import ApiClient
from rce.api.views.resources import RobotView
from rce.client import Robot
from tests.support.e2e.real_platform import USER, kill_processes

MODULES = {"master": "master", "robot": "endpoints.robot", "container": "containers"}
START_TIMEOUT = 120.0
STOP_TIMEOUT = 120.0
GRACE, MACHINE_GRACE = 10.0, 2.0  # seconds; a robot on a busy machine returns within the first


@dataclass(frozen=True)
class Host:
    """A machine.

    Attributes:
        name: Its name.
        address: IP address.
        command_prefix: Words before a command that run it on the machine.
        tls: Directory of certificates, or None without TLS.
        docker: Address of its Docker daemon, or "" for the local one.
    """

    name: str
    address: str = "127.0.0.1"
    command_prefix: tuple[str, ...] = ()
    tls: Path | None = None
    docker: str = ""

    def tls_words(self) -> list[str]:
        return [f"--tls={self.tls}"] if self.tls else []


class Program:
    """A program on a machine."""

    def __init__(self, kind: str, host: Host, log: Path, token: str) -> None:
        self.kind = kind
        self.host = host
        self.log = log
        self.ready: dict[str, str] = {}
        self.process: asyncio.subprocess.Process
        self._token = token
        self._words: Sequence[str] = ()

    async def start(self, *words: str) -> None:
        """Start the program; without words, with those of the previous start."""
        self._words = words or self._words
        environment = {**os.environ, ("RCE_TOKENS" if self.kind == "master" else "RCE_TOKEN"): self._token}
        if self.host.docker:
            environment["DOCKER_HOST"] = self.host.docker
        command = [*self.host.command_prefix, sys.executable, "-P", "-m", MODULES[self.kind], *self._words]
        with self.log.open("a") as log:
            self.process = await asyncio.create_subprocess_exec(
                *command, stdout=asyncio.subprocess.PIPE, stderr=log, env=environment
            )
        assert self.process.stdout is not None
        line = await asyncio.wait_for(self.process.stdout.readline(), START_TIMEOUT)
        assert line, self.log.read_text()[-4000:]
        self.ready = json.loads(line)

    async def stop(self) -> None:
        if self.process.returncode is None:
            self.process.send_signal(signal.SIGTERM)
            status = await asyncio.wait_for(self.process.wait(), STOP_TIMEOUT)
            assert status == 0, self.log.read_text()[-4000:]

    async def kill(self) -> None:
        self.process.kill()
        await self.process.wait()


class Machines:
    """A platform of several machines, each with `size` slots. `async with` starts and stops it.

    `arguments` are those of the task sets.
    """

    def __init__(
        self,
        directory: Path,
        master: Host,
        hosts: Sequence[Host],
        arguments: Sequence[str],
        size: int,
        ws_port: int = 9010,
    ) -> None:
        self.directory = directory
        self.hosts = {host.name: host for host in hosts}
        self._arguments = arguments
        self._size = size
        self._ws_port = ws_port
        self._tokens = {
            f"{kind}-{name}": secrets.token_hex(32) for kind in ("robot", "container") for name in self.hosts
        }
        allowed = ",".join(f"{name.partition('-')[0]}:{name}:{token}" for name, token in self._tokens.items())
        self.master = Program("master", master, directory / "master.log", allowed)
        self.programs = {
            name: Program(kind, self.hosts[host], directory / f"{name}.log", token)
            for name, token in self._tokens.items()
            for kind, _, host in [name.partition("-")]
        }

    async def __aenter__(self) -> Self:
        try:
            await self.start()
        except BaseException:
            kill_processes(self.directory)
            raise
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            await self.stop()
        else:
            kill_processes(self.directory)

    async def start(self) -> None:
        host = self.master.host
        await self.master.start(
            f"--data-dir={self.directory / 'master'}",
            "--http=tcp:0:interface=127.0.0.1",
            f"--control=tcp:0:interface={host.address}",
            "--dev",
            f"--grace={GRACE}",
            f"--machine-grace={MACHINE_GRACE}",
            *host.tls_words(),
        )
        await asyncio.gather(*map(self.start_program, self.programs))

    async def start_program(self, name: str) -> None:
        program = self.programs[name]
        host = program.host
        words = [
            f"--data-dir={self.directory / name}",
            f"--name={name}",
            f"--master={self.master.ready['control']}",
            f"--host={host.name}",
            f"--data-host={host.address}",
            *host.tls_words(),
        ]
        if program.kind == "robot":
            port = self._ws_port if host.command_prefix else 0  # every port is free in a network namespace
            public = f"ws://{host.address}:{port}/" if port else ""
            words += [f"--ws-host={host.address}", f"--ws-port={port}", f"--public-url={public}"]
            words += [f"--grace={GRACE}"]
        else:
            words += [
                f"--features={host.name}",
                f"--size={self._size}",
                "--stop-environments",
                *self._arguments,
            ]
        await program.start(*words)

    async def stop(self) -> None:
        """Stop the task sets first, which stop their environments, and check that no process is left."""
        for kind in ("container", "robot"):
            await asyncio.gather(*(program.stop() for program in self.programs.values() if program.kind == kind))
        await self.master.stop()
        left = kill_processes(self.directory)
        assert not left, f"processes are left over: {left}"

    def robot(self, name: str, timeout: float = 60.0) -> Robot:
        return Robot(self.master.ready["url"], user=USER, robot=name, password=USER, timeout=timeout)

    async def wait_for_no_robots(self) -> None:
        """Wait until all robots have left, so that the next two get different Robot endpoints."""
        api = ApiClient(self.master.ready["url"], user=USER, password=USER)
        async with asyncio.timeout(60):
            while await asyncio.to_thread(lambda: [*api.items(RobotView, "robots")]):  # noqa: ASYNC110
                await asyncio.sleep(0.1)

    def url(self, host: str) -> str:
        """Return the URL of the Robot endpoint on a machine."""
        return self.programs[f"robot-{host}"].ready["url"].replace("://:", f"://{self.hosts[host].address}:")

    def on(self, host: str) -> list[Program]:
        """Return the programs on a machine."""
        return [program for program in self.programs.values() if program.host.name == host]

    async def revive(self, host: str) -> None:
        """Start the programs of a machine again."""
        await asyncio.gather(*(self.start_program(f"{program.kind}-{host}") for program in self.on(host)))

    def log(self, name: str) -> str:
        return (self.directory / f"{name}.log").read_text()

    def machine_of(self, tag: str) -> str:
        """Return the machine that an environment was started on last."""
        started = [
            (json.loads(line)["time"], name)
            for name in self.hosts
            for line in self.log(f"container-{name}").splitlines()
            if f"started {USER}/{tag}" in line  # others may be incomplete
        ]
        return max(started)[1]
