"""Faults: a Master is killed, stopped, cut off, its clock jumps, or connections to the database end."""

from __future__ import annotations

import asyncio
import random
import signal
from typing import Literal, NamedTuple

from rce.bench.standby.platform import DATABASE, MASTERS, Platform
from rce.bench.standby.terms import TermWatch

Kind = Literal[
    "kill", "kill, no restart", "stop", "stop past the lease", "cut", "cut past the lease", "terminate", "clock"
]
Victim = Literal["leader", "standby", "database"]
SHORT = 0.5, 3.0  # seconds
LONG = 12.5, 14.0  # seconds: longer than the lease
JUMPS = (-3600.0, -30.0, 30.0, 3600.0)  # seconds
DEPOSING = ("kill, no restart", "stop past the lease", "cut past the lease")
CHOICES: dict[tuple[Kind, Victim], int] = {
    ("kill", "leader"): 4,
    ("kill", "standby"): 2,
    ("kill, no restart", "leader"): 3,
    ("stop", "leader"): 3,
    ("stop", "standby"): 1,
    ("stop past the lease", "leader"): 4,
    ("cut", "leader"): 2,
    ("cut", "database"): 2,
    ("cut past the lease", "leader"): 2,
    ("terminate", "database"): 5,
    ("clock", "leader"): 2,
    ("clock", "database"): 2,
}
"""Weight of each kind of fault. The clock of the database is among them, since it decides when a lease ends."""
TERMINATE = (
    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
    " WHERE pid <> pg_backend_pid() AND backend_type = 'client backend'"
)


class Fault(NamedTuple):
    """A fault, how long it lasts in seconds, and by how many seconds a clock jumps."""

    kind: Kind
    victim: Victim
    seconds: float = 0.0
    jump: float = 0.0

    @property
    def label(self) -> str:
        """Row of the table."""
        return f"{self.victim}: {self.kind}"

    @property
    def deposes(self) -> bool:
        """True if another Master must lead afterwards."""
        return self.kind in DEPOSING


def choose(rng: random.Random, clocks: bool) -> Fault:
    """Return a random fault; `clocks` tells whether clocks can jump."""
    possible = {key: weight for key, weight in CHOICES.items() if clocks or key[0] != "clock"}
    kind, victim = rng.choices(list(possible), list(possible.values()))[0]
    if kind in ("kill", "terminate"):
        return Fault(kind, victim)
    if kind == "clock":
        return Fault(kind, victim, rng.uniform(*SHORT), rng.choice(JUMPS))
    return Fault(kind, victim, rng.uniform(*(LONG if kind in DEPOSING else SHORT)))


class Nemesis:
    """Makes faults happen."""

    def __init__(self, platform: Platform, terms: TermWatch) -> None:
        """Prepare faults of a platform."""
        self._platform = platform
        self._terms = terms

    def name(self, victim: Victim) -> str:
        """Return the name of the machine of a victim."""
        if victim == "database":
            return DATABASE
        leader = next(each for each in MASTERS if self._platform.url(each) == self._terms.url)
        return leader if victim == "leader" else next(each for each in MASTERS if each != leader)

    async def strike(self, fault: Fault) -> None:
        """Let a fault happen and end."""
        name = self.name(fault.victim)
        match fault.kind:
            case "kill":
                self._platform.programs[name].signal(signal.SIGKILL)
            case "kill, no restart":
                await self._kill(name, fault.seconds)
            case "stop" | "stop past the lease":
                await self._stop(name, fault.seconds)
            case "cut" | "cut past the lease":
                await self._cut(name, fault.seconds)
            case "terminate":
                await self._terminate()
            case "clock":
                await self._jump(name, fault)

    async def _kill(self, name: str, seconds: float) -> None:
        program = self._platform.programs[name]
        program.hold()
        try:
            program.signal(signal.SIGKILL)
            await asyncio.sleep(seconds)
        finally:
            program.release()

    async def _stop(self, name: str, seconds: float) -> None:
        program = self._platform.programs[name]
        program.signal(signal.SIGSTOP)
        try:
            await asyncio.sleep(seconds)
        finally:
            program.signal(signal.SIGCONT)

    async def _cut(self, name: str, seconds: float) -> None:
        await asyncio.to_thread(self._platform.network.cut, name)
        try:
            await asyncio.sleep(seconds)
        finally:
            await asyncio.to_thread(self._platform.network.reconnect, name)

    async def _terminate(self) -> None:
        import psycopg  # an extra

        async with await psycopg.AsyncConnection.connect(self._platform.database.local, autocommit=True) as connection:
            await connection.execute(TERMINATE)

    async def _jump(self, name: str, fault: Fault) -> None:
        self._platform.clocks[name].set(fault.jump)
        try:
            await asyncio.sleep(fault.seconds)
        finally:
            self._platform.clocks[name].set(0.0)
