"""Platforms for tests: Master and Robot endpoint in this process, or as processes of their own."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import argon2
from twisted.internet.base import ReactorBase

import rce
from endpoints.data.port import DataPort
from endpoints.gateways.paths import gateways
from endpoints.robot import server
from endpoints.robot.endpoint import Options, RobotEndpoint
from endpoints.robot.frame_receiver import ServerLimits
from master.service import Master
from rce.control.calls.joining import Hello
from rce.control.calls.robots import SessionExpired
from rce.control.client import ControlClient
from rce.control.server import listen
from rce.process import ready
from tests.support.endpoints.raw_robot import USER, WAIT, Robot, RobotClients, status
from tests.support.master.database import open_store


class Platform(RobotClients):
    """Master and one Robot endpoint in this process, with real sockets."""

    def __init__(self, reactor: ReactorBase, limits: ServerLimits, grace: float, timeout: float) -> None:
        self.reactor = reactor
        self.grace = grace
        self.endpoint = RobotEndpoint(DataPort(), Options(limits, grace, timeout))
        self._tasks: list[asyncio.Task[None]] = []

    async def start(self) -> None:
        self.store = await open_store()
        self.master = Master(self.store, self.grace)
        cheap = argon2.PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)  # tests log in often
        self.master.users.passwords.hasher = cheap
        await self.master.users.add("admin", "admin", "admin")
        await self.master.users.add(USER, USER)
        await self.master.join_tokens.allow("robot-1", "robot", "token")
        await self.master.start()
        self._control = await listen(self.reactor, "tcp:0:interface=127.0.0.1", self.master)
        description = f"tcp:127.0.0.1:{self._control.getHost().port}"  # type: ignore[misc]
        joined = asyncio.Event()
        self.server = await server.listen(self.endpoint, "127.0.0.1", 0, None, gateways(self.endpoint))
        port = self.server.port
        credential = ["token"]

        def hello() -> Hello:
            robots = list(self.endpoint.sessions)
            return Hello("robot", "robot-1", credential[0], rce.__version__, "1", "host", [], "ws://:1/", robots=robots)

        def welcomed(welcome: Any) -> None:
            credential[0] = welcome.credential
            joined.set()

        self.endpoint.master = ControlClient(self.reactor, description, hello, self.endpoint.handlers(), welcomed)
        self._tasks.append(asyncio.create_task(self.endpoint.master.run()))
        await asyncio.wait_for(joined.wait(), WAIT)
        super().__init__(port)

    async def forget(self, tag: str) -> None:
        """End a robot's session, if it has one."""
        name = f"{USER}/{tag}"
        await self.endpoint.master.call(SessionExpired(name))
        session = self.endpoint.sessions.pop(name, None)
        if session is not None:
            session.end("forgotten")

    async def stop(self) -> None:
        await self.close()
        self.server.close()
        self.endpoint.workers.close()
        for session in list(self.endpoint.sessions.values()):
            session.end("the test has ended")
        for timer in list(self.endpoint._grace_timers.values()):
            timer.cancel()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.master.stop()
        await self._control.stopListening().asFuture(asyncio.get_running_loop())  # type: ignore[misc,union-attr]
        await self.store.close()


class Processes(RobotClients):
    """Master and Robot endpoint as processes of their own."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.master_port = 0
        self._running: dict[str, asyncio.subprocess.Process] = {}

    async def _run(self, program: str, *arguments: str, **environment: str) -> ready.Ready:
        log = (self.directory / f"{program}.log").open("a")
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-P",
            "-m",
            program,
            *arguments,
            env=os.environ | environment,
            stdout=subprocess.PIPE,
            stderr=log,
        )
        log.close()
        self._running[program] = process
        assert process.stdout is not None
        async with asyncio.timeout(WAIT):
            while line := await process.stdout.readline():
                if (announced := ready.parse(line)) is not None:
                    return announced
        raise AssertionError(f"{program} ended: {(self.directory / f'{program}.log').read_text()}")

    async def start_master(self, control: str = "tcp:0:interface=127.0.0.1", tokens: str = "") -> str:
        """Start the Master; return the address of its control port. It also accepts processes with these tokens."""
        announced = await self._run(
            "master",
            "--dev",
            *("--data-dir", str(self.directory / "m")),
            *("--http", "tcp:0:interface=127.0.0.1"),
            *("--control", control),
            RCE_TOKENS=f"robot:robot-1:abc{tokens and ','}{tokens}",
        )
        self.url = announced.url
        return announced.control

    async def start_robot(self, control: str, *options: str) -> None:
        announced = await self._run(
            "endpoints.robot",
            *("--data-dir", str(self.directory / "r"), "--master", control, "--ws-port", "0"),
            *options,
            RCE_TOKEN="abc",
        )
        self.port = int(announced.url.rstrip("/").rpartition(":")[2])
        super().__init__(self.port)

    def process(self, program: str) -> asyncio.subprocess.Process:
        return self._running[program]

    async def kill(self, program: str) -> None:
        self._running[program].kill()
        await self._running.pop(program).wait()

    async def stop(self) -> Mapping[str, int]:
        """Stop all processes; return the exit status of each."""
        for process in self._running.values():
            with suppress(ProcessLookupError):
                process.terminate()
        status = {}
        for program, process in self._running.items():
            try:
                status[program] = await asyncio.wait_for(process.wait(), WAIT)
            except TimeoutError:
                process.kill()
                status[program] = await process.wait()
        return status

    def log(self, program: str) -> str:
        return (self.directory / f"{program}.log").read_text()


async def pair(
    platform: Platform, kind: str = "std_msgs/String", features: str = "", **more: Any
) -> tuple[Robot, Robot]:
    """Return two robots, with a/out connected to b/in."""
    a, b = await platform.robot("a", features), await platform.robot("b", features)
    if features:
        await a.receive()
        await b.receive()
    await a.add("out", "SubscriberConverter", kind, **more)
    await a.add("in", "PublisherConverter", kind, of="b", **more)
    await a.connect("a/out", "b/in")
    assert await a.receive() == status("out", True)
    assert await b.receive() == status("in", True)
    return a, b
