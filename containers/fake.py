"""Engines without environments, for tests and for trials of scale; they pass the suite that the real ones pass.

`FakeEngine` behaves; the others misbehave as their names say. A `FakeMachine` is the world outside of the process: it
stays when the engine is made anew, as containers stay when the task set is restarted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection

from containers.engine import Ended, Engine, Life
from rce.calls.environments import EnvironmentSpec
from rce.calls.watching import Used
from rce.errors import StartFailed, Unavailable


class FakeMachine:
    """What runs, and what was left half-started, by name."""

    def __init__(self) -> None:
        self.running: dict[str, Life] = {}
        self.leftovers: dict[str, str] = {}
        self.watcher: FakeEngine | None = None
        self.used: dict[str, Used] = {}

    def end(self, name: str, status: int) -> None:
        """The environment ends by itself; like a dead container it stays until somebody removes it."""
        life = self.running.pop(name)
        self.leftovers[name] = life.run
        if self.watcher is not None:
            self.watcher.died(name, life.run, f"ended with status {status}", status)


class FakeEngine(Engine):
    """Environments that are entries in the dictionaries of a FakeMachine."""

    def __init__(
        self,
        capacity: int,
        features: Collection[str],
        ended: Callable[[Ended], None],
        machine: FakeMachine | None = None,
    ) -> None:
        super().__init__(capacity, features, ended)
        self.machine = machine or FakeMachine()

    async def launch(self, spec: EnvironmentSpec) -> None:
        self.machine.leftovers[spec.name] = spec.run
        await asyncio.sleep(0)
        del self.machine.leftovers[spec.name]
        self.machine.running[spec.name] = Life(spec.run, spec.options.size)

    async def remove(self, name: str) -> None:
        life = self.machine.running.pop(name, None)
        self.machine.leftovers.pop(name, None)
        if life is not None:
            self.died(name, life.run, "killed by SIGTERM", -15)
        await asyncio.sleep(0)

    async def recover(self) -> dict[str, Life]:
        self.machine.leftovers.clear()
        self.machine.watcher = self
        return dict(self.machine.running)

    async def last_lines(self, name: str) -> list[str]:
        return [f"last words of {name}"]

    async def usage(self) -> dict[str, Used]:
        return {name: self.machine.used.get(name, Used(0.0, 1)) for name in self.machine.running}

    async def release(self) -> None:
        self.machine.watcher = None


class SlowEngine(FakeEngine):
    """Starts wait until `go` is set."""

    go: asyncio.Event

    async def launch(self, spec: EnvironmentSpec) -> None:
        self.machine.leftovers[spec.name] = spec.run
        await self.go.wait()
        await super().launch(spec)

    async def recover(self) -> dict[str, Life]:
        self.go = asyncio.Event()
        return await super().recover()


class NeverEngine(FakeEngine):
    """Starts never come to an end."""

    async def launch(self, spec: EnvironmentSpec) -> None:
        self.machine.leftovers[spec.name] = spec.run
        await asyncio.get_running_loop().create_future()


class FailingEngine(FakeEngine):
    """Starts fail."""

    async def launch(self, spec: EnvironmentSpec) -> None:
        self.machine.leftovers[spec.name] = spec.run
        raise StartFailed(f"environment {spec.name}: no such image", lines=["pull access denied"])


class DyingEngine(FakeEngine):
    """Environments end as soon as they run."""

    async def launch(self, spec: EnvironmentSpec) -> None:
        await super().launch(spec)
        self.machine.end(spec.name, 1)


class AwayEngine(FakeEngine):
    """What the environments run on does not answer while `away` is set; what it was told to do may be half done."""

    away = False

    async def launch(self, spec: EnvironmentSpec) -> None:
        self.machine.leftovers[spec.name] = spec.run
        self._reach()
        await super().launch(spec)

    async def remove(self, name: str) -> None:
        self._reach()
        await super().remove(name)

    def _reach(self) -> None:
        if self.away:
            raise Unavailable("nobody answers")
