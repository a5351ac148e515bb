"""Faults: a process is killed or stopped, or its disk is full; and when what it does works again."""

from __future__ import annotations

import asyncio
import os
import random
import signal
import time
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Literal, NamedTuple

from rce.bench.chaos import processes
from rce.bench.chaos.platform import ENDPOINTS, MAPS, TASK_SET, USER, Platform
from rce.errors import RceError, TimedOut

Kind = Literal["kill", "stop", "disk"]
Probe = Callable[[float], Awaitable[None]]
"""Something that works only if a victim does, given the time of the fault's end; called again after an RceError."""
RECOVERY_TIMEOUT = 300.0  # seconds
POLL_INTERVAL = 0.02  # seconds
STOPS = 0.3, 3.0  # seconds
LONG_STOP, LONG_STOP_SHARE = 17.0, 0.04  # longer than it takes until the Master regards a process as lost
DISKS = 1.0, 3.0  # seconds for which a disk is full
STEADY = 7.0  # seconds that a node must have run, or it would not be started again
WORDS = {"kill": "killed", "stop": "stopped", "disk": "disk full"}
NAMES = {"master": "Master", TASK_SET: "task set", MAPS: "map service", **dict.fromkeys(ENDPOINTS, "Robot endpoint")}
ENVIRONMENT, NODE_OF = "environment ", "node of "


class Fault(NamedTuple):
    """A fault.

    Attributes:
        kind: What happens.
        victim: Name of a process of the platform, or `environment TAG`, or `node of TAG`.
        seconds: How long it lasts; 0 for a kill.
    """

    kind: Kind
    victim: str
    seconds: float

    def __str__(self) -> str:
        return f"{self.victim} {WORDS[self.kind]}" + (f" for {self.seconds:.1f} s" if self.seconds else "")

    @property
    def label(self) -> str:
        """Row of the table of recovery times."""
        victim = self.victim.partition(" ")[0]
        names = {
            "master": "Master",
            TASK_SET: "task set",
            MAPS: "map service",
            **dict.fromkeys(ENDPOINTS, "Robot endpoint"),
        }
        return f"{names.get(victim, victim)} {WORDS[self.kind]}"


def choose(rng: random.Random, environments: Sequence[str], disks: bool, long: bool) -> Fault:
    """Return a random fault.

    Args:
        rng: Source of randomness.
        environments: Environments that may fail, each of which has a node.
        disks: Disks can be filled.
        long: Some processes are stopped for so long that the Master regards them as lost.
    """
    programs = [["master"], list(ENDPOINTS), [TASK_SET], [MAPS]]
    inside = [[f"{kind}{tag}" for tag in environments] for kind in (ENVIRONMENT, NODE_OF)]
    kind: Kind = rng.choices(("kill", "stop", "disk"), (5, 3, 2 if disks else 0))[0]
    victim = rng.choice(rng.choice(programs if kind == "disk" else programs + inside))
    if kind == "kill":
        return Fault(kind, victim, 0.0)
    if kind == "disk":
        return Fault(kind, victim, rng.uniform(*DISKS))
    return Fault(kind, victim, LONG_STOP if long and rng.random() < LONG_STOP_SHARE else rng.uniform(*STOPS))


class Nemesis:
    """Makes processes fail."""

    def __init__(self, platform: Platform, probes: Mapping[str, Probe]) -> None:
        """Prepare faults of a platform.

        Args:
            platform: The platform.
            probes: By victim, what it must do to count as recovered.
        """
        self._platform = platform
        self._probes = probes

    async def strike(self, fault: Fault) -> float:
        """Let a fault happen and end; return the monotonic time of its end."""
        if fault.kind == "disk":
            disk = self._platform.disks[fault.victim]
            disk.fill()
            try:
                await asyncio.sleep(fault.seconds)
            finally:
                await disk.free()
            return time.monotonic()
        pid = await self._pid(fault.victim)
        if fault.kind == "kill":
            os.kill(pid, signal.SIGKILL)
            return time.monotonic()
        os.kill(pid, signal.SIGSTOP)
        try:
            await asyncio.sleep(fault.seconds)
        finally:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        return time.monotonic()

    async def recovered(self, fault: Fault, ended: float) -> float:
        """Wait until the victim works again; return the seconds since the fault ended.

        Raises:
            TimedOut: It does not within RECOVERY_TIMEOUT.
        """
        reason = ""
        try:
            async with asyncio.timeout(RECOVERY_TIMEOUT):
                while True:
                    try:
                        await self._probes[fault.victim](ended)
                        return time.monotonic() - ended
                    except RceError as error:
                        reason = str(error)
                    await asyncio.sleep(POLL_INTERVAL)
        except TimeoutError:
            raise TimedOut(f"{fault}: not recovered {RECOVERY_TIMEOUT:g} s after its end: {reason}") from None

    async def _pid(self, victim: str) -> int:
        """Return the pid of a victim that has run for long enough to be restarted; wait for one.

        Raises:
            TimedOut: There is none.
        """
        until = time.monotonic() + RECOVERY_TIMEOUT
        while (pid := self._find(victim)) == 0:
            if time.monotonic() > until:
                raise TimedOut(f"{victim} does not run")
            await asyncio.sleep(POLL_INTERVAL)
        return pid

    def _find(self, victim: str) -> int:
        if victim in self._platform.processes:
            pid = self._platform.processes[victim].pid
            with suppress(OSError):
                if str(self._platform.directory).encode() in Path(f"/proc/{pid}/cmdline").read_bytes():
                    return pid
            return 0
        tag = victim.rpartition(" ")[2]
        wants_node = victim.startswith(NODE_OF)
        for each in processes.of_environments(self._platform.directory / TASK_SET, USER):
            if each.environment == tag and bool(each.node) == wants_node and processes.age(each.pid) > STEADY:
                return each.pid
        return 0
