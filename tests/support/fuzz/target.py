"""The attacked processes: Master, Robot endpoint, map service and knowledge service, and what must hold of them."""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import psutil

from rce.api.client import ApiClient
from rce.api.views import CreatedKey, NewKey, NewUser
from rce.bench.cores import set_apart
from rce.control.calls.knowledge import SERVICE
from tests.support.endpoints.platforms import Processes
from tests.support.endpoints.raw_robot import USER as ATTACKER
from tests.support.fuzz.bystander import PASSWORD, USER, Figures
from tests.support.paths import ROOT

TOKENS = {role: f"{role}-token" for role in ("robot", "container", "service")}
KNOWLEDGE_TOKEN = "knowledge-token"
NAMES = {"robot": "fuzz-robot", "container": "fuzz-machine", "service": "map-service"}
MAX_MEMORY = 1024**3  # bytes of each process; a quiet Robot endpoint takes 70 MB
SETTLE = 3.0  # seconds in which the bystander is measured without an attack
SETTLE_APART = 20.0  # the same with `apart`, where its 99th percentile counts
BAD_LEVELS = ("error", "critical")


class Target:
    """Processes with a bystander. Each test calls `check` at its end.

    Attributes:
        processes: All of them.
        control: Address of the Master's control port.
        maps: URL of the map service.
        knowledge: URL of the knowledge service.
        figures: What the bystander saw, by name of the attack.
    """

    def __init__(self, directory: Path) -> None:
        self.processes = Processes(directory)
        self.directory = directory
        self.figures: dict[str, Figures] = {}
        self.memory: dict[str, int] = {}
        self._read: dict[str, int] = {}
        self._bystander: asyncio.subprocess.Process | None = None
        self._mover: asyncio.Task[None] | None = None

    async def start(self, *, apart: bool) -> None:
        """Start all processes, and measure the bystander without an attack.

        Args:
            apart: Treat attackers, bystander and Robot endpoint as if each were on another machine. This needs root and
                two cores.
        """
        allowed = ",".join(f"{role}:{NAMES[role]}:{token}" for role, token in TOKENS.items())
        allowed += f",service:{SERVICE}:{KNOWLEDGE_TOKEN}"
        processes = self.processes
        self.control = await processes.start_master(tokens=allowed)
        # Frames are counted as bad, but no limit closes the socket, so that more of them are handled.
        await processes.start_robot(self.control, "--bad-messages", "0", "--grace", "1")
        self.maps = await self._start_maps()
        self.knowledge = await self._start_knowledge()
        admin = ApiClient(processes.url, user="admin", password="admin")
        await asyncio.to_thread(lambda: admin.post(Any, "users", body=NewUser(USER, PASSWORD)))
        words = [sys.executable, "-m", "tests.support.fuzz.bystander", processes.url]
        pipe = subprocess.PIPE
        self._bystander = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe, cwd=ROOT)
        if apart:
            self._set_apart(self._bystander.pid)
        await self._measure()
        await asyncio.sleep(SETTLE_APART if apart else SETTLE)
        self.figures["quiet"] = await self._measure()

    def _set_apart(self, bystander: int) -> None:
        """Run attackers only while the platform does not run, and the bystander before all others.

        The Robot endpoint has a core that it shares with the bystander alone.
        """
        os.sched_setscheduler(bystander, os.SCHED_RR, os.sched_param(1))
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        self._mover = asyncio.create_task(_set_apart({bystander, self.processes._running["endpoints.robot"].pid}))

    async def _start_maps(self) -> str:
        words = ("--data-dir", str(self.directory / "maps"), "--master", self.control, "--port", "0")
        announced = await self.processes._run(
            "rce.mapservice", *words, "--entry", self.processes.url, RCE_TOKEN=TOKENS["service"]
        )
        return f"http://127.0.0.1:{port_of(announced.url)}"

    async def _start_knowledge(self) -> str:
        words = ("--data-dir", str(self.directory / "knowledge"), "--master", self.control, "--port", "0")
        announced = await self.processes._run("rce.knowledge", *words, "--query-time", "2", RCE_TOKEN=KNOWLEDGE_TOKEN)
        return f"http://127.0.0.1:{port_of(announced.url)}"

    async def stop(self) -> None:
        if self._mover is not None:
            self._mover.cancel()
        if self._bystander is not None:
            with suppress(ProcessLookupError):
                self._bystander.kill()
            await self._bystander.wait()
        await self.processes.stop()

    async def create_key(self) -> str:
        """Return a new API key of the attacking user: wrong ones are not counted, as wrong passwords are."""
        user = ApiClient(self.processes.url, user=ATTACKER, password=ATTACKER)
        return (await asyncio.to_thread(lambda: user.post(CreatedKey, "keys", body=NewKey("user", "fuzz")))).secret

    async def check(self, attack: str) -> None:
        """Assert that an attack has ended no process, caused no defect, filled no memory and disturbed nobody."""
        for program, process in self.processes._running.items():
            assert process.returncode is None, f"{program} ended\n{self.processes.log(program)[-4000:]}"
            used = psutil.Process(process.pid).memory_info().rss
            self.memory[program] = max(used, self.memory.get(program, 0))
            assert used < MAX_MEMORY, f"{program} takes {used / 1e6:.0f} MB"
        assert not (defects := list(self.defects())), "\n".join(defects[:5])
        found = self.figures[attack] = await self._measure()
        assert found.wrong == 0, found

    def defects(self) -> list[str]:
        """Return what the processes have logged as errors, or with a traceback, since the last call."""
        found = []
        for program in self.processes._running:
            log = self.processes.log(program)
            end = log.rfind("\n") + 1  # what follows is being written
            lines = log[self._read.get(program, 0) : end].split("\n")  # `splitlines` splits at more than that
            self._read[program] = end
            found += [f"{program}: {line}" for line in lines if _is_defect(line)]
        return found

    async def _measure(self) -> Figures:
        process = self._bystander
        assert process is not None and process.stdin is not None and process.stdout is not None  # noqa: PT018
        process.stdin.write(b"\n")
        line = await asyncio.wait_for(process.stdout.readline(), 60)
        assert line, "the bystander's robots were disconnected, or it failed"
        return msgspec.json.decode(line, type=Figures)


async def _set_apart(pids: set[int]) -> None:
    """Let these processes have cores of their own; workers of the Robot endpoint begin with its cores."""
    while True:
        set_apart(lambda process: process.pid in pids)
        await asyncio.sleep(0.1)


def port_of(url: str) -> int:
    """Return the port at the end of a URL, which may have no host."""
    return int(url.rstrip("/").rpartition(":")[2])


def _is_defect(line: str) -> bool:
    """Return True for an error; a line that is no JSON is one of the interpreter, such as a warning."""
    try:
        entry: dict[str, Any] = msgspec.json.decode(line)
    except msgspec.DecodeError:
        return bool(line.strip())
    return entry["level"] in BAD_LEVELS or "traceback" in entry
